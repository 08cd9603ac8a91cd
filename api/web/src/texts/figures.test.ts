import { expect, test } from "vitest";

import { bytesText } from "./figures";

test.each([
  [0, "0 B"],
  [999, "999 B"],
  [1500, "1.5 kB"],
  [250e6, "250 MB"],
  [3e12, "3000 GB"],
])("%d bytes are %s", (bytes, text) => expect(bytesText(bytes)).toBe(text));

import { expect, test } from "vitest";

import { sentence } from "./sentence";

test.each([
  ["the upload has no images", "files", "The upload has no images."],
  ["zz_bad.jpg is not an image", "zz_bad.jpg", "zz_bad.jpg is not an image."],
  ["lens cannot be that", "lens", "Lens cannot be that."],
  ["what now?", "", "What now?"],
])("%s", (message, field, said) => expect(sentence(message, field)).toBe(said));

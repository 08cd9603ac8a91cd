import { expect, test } from "vitest";

import { objectsTexts } from "./objects";

const { titleOf, level, unnamedCount } = objectsTexts.objects;

test("a name that is a guess says so, with its probability", () => {
  expect(titleOf({ id: 3, name: "chair", guess: true, probability: 0.9 })).toBe("chair (a guess, 90 %)");
  expect(titleOf({ id: 3, name: "chair", guess: false, probability: 0.97 })).toBe("chair");
  expect(titleOf({ id: 3, name: "" })).toBe("Object 3, no name");
});

test("a level says what it is of", () => {
  const [mug, handle] = [
    { id: 1, name: "mug" },
    { id: 4, name: "handle" },
  ];
  expect(level("part", mug, { id: 4, name: "" }, 0)).toBe("part of mug");
  expect(level("part", mug, handle, 0)).toBe("handle, part of mug");
  expect(level("object", mug, handle, 0)).toBe("mug");
  expect(level("group", mug, null, 3)).toBe("group: mug and 2 more");
});

test("all that is listed without a name is counted", () => {
  expect(unnamedCount(6, 4)).toBe("6 objects and 4 surfaces without a name");
  expect(unnamedCount(1, 0)).toBe("1 object without a name");
  expect(unnamedCount(0, 1)).toBe("1 surface without a name");
  expect(unnamedCount(0, 0)).toBe("All objects have names.");
});

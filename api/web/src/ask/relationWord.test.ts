import { expect, test } from "vitest";
import { relationWord } from "./relationWord";

test("a banana is a kind of fruit, and an armchair is only the closest to a chair that is asked for", () => {
  expect(relationWord({ relation: "kind_of", relation_subject: "label" })).toBe("A kind of it");
  expect(relationWord({ relation: "kind_of", relation_subject: "question" })).toBe("Closest match");
  expect(relationWord({ relation: "same", relation_subject: null })).toBe("Here it is");
  expect(relationWord({ relation: "absent", relation_subject: null })).toBe("Not here");
});

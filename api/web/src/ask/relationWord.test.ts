import { expect, test } from "vitest";
import { knownLabels } from "./knownLabels";
import { relationWord } from "./relationWord";

type Said = Parameters<typeof relationWord>[0];
const word = (said: Partial<Said>) =>
  relationWord({ verdict: "related", probability: null, relation: "same", relation_subject: null, ...said });

test("a banana is a kind of fruit, and an armchair is only the closest to a chair that is asked for", () => {
  expect(word({ relation: "kind_of", relation_subject: "label" })).toBe("A kind of it");
  expect(word({ relation: "kind_of", relation_subject: "question" })).toBe("Closest match");
  expect(word({ verdict: "exact" })).toBe("Here it is");
  expect(word({ verdict: "absent", relation: "absent" })).toBe("Not here");
  expect(word({ verdict: "undecided", relation: "undecided" })).toBe("Cannot say");
});

test("what may be here is said as its figure says", () => {
  expect(word({ verdict: "possible", probability: 0.9 })).toBe("Probably here");
  expect(word({ verdict: "possible", probability: 0.19 })).toBe("Possibly here");
});

test("no label is offered that nothing bears and nothing is suggested for", () => {
  const entry = { aliases: [], pixels: 0, views: 0 };
  const entries = [
    { ...entry, label_id: 1, label: "cup", gaussian_count: 9 },
    { ...entry, label_id: 2, label: "dining table", gaussian_count: 0 },
    { ...entry, label_id: 3, label: "tulip", gaussian_count: 0 },
  ];
  const unnamed = { name: "", suggestions: [{ name: "dining table", probability: 0.19, scene_id: "" }] };
  expect(knownLabels(entries, [unnamed])).toEqual(["cup", "dining table"]);
  expect(knownLabels(entries, null)).toEqual(["cup"]);
});

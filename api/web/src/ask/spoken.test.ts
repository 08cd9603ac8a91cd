import { expect, test } from "vitest";

import { spoken } from "./spoken";

test.each([
  ['Here (97 %): "mug" for "cup".', { word: "Here", figure: "97 %", rest: '"mug" for "cup".' }],
  ["Here: 3 (2 apples): red.", { word: "Here", figure: "", rest: "3 (2 apples): red." }],
  ["Probably here (53 %): the cup.", { word: "Probably here", figure: "53 %", rest: "the cup." }],
  ["Cannot say.", { word: "Cannot say", figure: "", rest: "" }],
  ["something else", { word: "", figure: "", rest: "something else" }],
])("%s", (sentence, parts) => expect(spoken(sentence)).toEqual(parts));

/** What a sentence of the server opens with, so that it can be shown larger: the verdict, and the figure in brackets. */
interface Spoken {
  word: string;
  figure: string;
  rest: string;
}

/** The parts of "Here (97 %): the cup." in their order; a sentence of another form is all rest. */
export function spoken(sentence: string): Spoken {
  const match = /^([A-Z][a-z]+(?: [a-z]+)?)(?: \(([^)]*%)\))?(?:: ([^]+)|\.)$/.exec(sentence);
  if (!match) return { word: "", figure: "", rest: sentence };
  const [, word = "", figure = "", rest = ""] = match;
  return { word, figure, rest };
}

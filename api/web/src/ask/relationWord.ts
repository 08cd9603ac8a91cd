import type { Answer } from "../api/types";
import { texts } from "../texts";

/** What the first match is to the question, in a word or three; where the question is the narrower, just the closest. */
export function relationWord(answer: Pick<Answer, "relation" | "relation_subject">): string {
  return texts.ask.relations[answer.relation_subject === "question" ? "related" : answer.relation];
}

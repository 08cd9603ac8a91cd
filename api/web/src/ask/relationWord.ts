import type { Answer } from "../api/types";
import { texts } from "../texts";

type Said = Pick<Answer, "verdict" | "probability" | "relation" | "relation_subject">;

/** What an answer is in a word or three: what its first match is to the question; where that is the narrower, just the
 *  closest; what may be here only, by how likely it is. */
export function relationWord({ verdict, probability, relation, relation_subject }: Said): string {
  if (verdict === "possible") return (probability ?? 0) >= 0.5 ? texts.ask.probably : texts.ask.possibly;
  return texts.ask.relations[relation_subject === "question" ? "related" : relation];
}

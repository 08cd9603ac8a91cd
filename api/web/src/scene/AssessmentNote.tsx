import type { Assessment } from "../api/types";
import { texts } from "../texts";

/** How good the scene is and, if it is not good, why and what to do about it. */
export function AssessmentNote({ assessment }: { assessment: Assessment }) {
  const { grade, findings } = assessment;
  return (
    <section class={`assessment ${grade}`} aria-label={texts.assessment.title}>
      {findings.length === 0 ? (
        <p class="grade">{texts.assessment.grades[grade]}</p>
      ) : (
        <details>
          <summary class="grade">{texts.assessment.grades[grade]}</summary>
          <ul>
            {findings.map((finding) => (
              <li key={finding.reason}>
                {finding.message} {finding.advice}
              </li>
            ))}
          </ul>
        </details>
      )}
    </section>
  );
}

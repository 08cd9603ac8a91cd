import { texts } from "../texts";

/** Files of an upload that could not be used, each with its reason; nothing if there are none. */
export function LeftOutFiles({ files }: { files: unknown }) {
  const reasons = Object.entries((files ?? {}) as Record<string, string>);
  if (reasons.length === 0) return null;
  return (
    <details class="note" open={reasons.length <= 10}>
      <summary>{texts.upload.leftOut(reasons.length)}</summary>
      <ul>
        {reasons.map(([name, reason]) => (
          <li key={name}>{texts.upload.leftOutFile(name, reason)}</li>
        ))}
      </ul>
    </details>
  );
}

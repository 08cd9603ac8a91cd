import { texts } from "../texts";

/** A box of the form for a new scene: people are stored nowhere (`privacy`). */
export function WithholdPeople() {
  return (
    <div>
      <label class="check">
        <input type="checkbox" name="privacy" value="people" aria-describedby="withhold-people" />
        {texts.privacy.people}
      </label>
      <p class="hint" id="withhold-people">
        {texts.privacy.hint}
      </p>
    </div>
  );
}

/** What a scene's photos withhold, in a sentence; nothing where nobody looked for any. */
export function Withheld({ quality }: { quality: Readonly<Record<string, unknown>> }) {
  const report = quality.withheld as { privacy: string | null; photos: number; share: number } | null | undefined;
  if (!report) return null;
  return <p class="hint">{texts.privacy.withheld(report.privacy === "people", report.photos, report.share)}</p>;
}

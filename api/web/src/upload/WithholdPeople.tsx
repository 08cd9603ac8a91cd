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

import type { Operation } from "../api/types";
import { texts } from "../texts";
import { SceneOrder } from "./SceneOrder";

/** Names to search the scene for once more, by the server's open-set detector; what came of it. */
export function LookAgain({ sceneId, onDone, word = "" }: { sceneId: string; onDone: () => void; word?: string }) {
  return (
    <SceneOrder
      sceneId={sceneId}
      call="lookAgain"
      words={texts.lookAgain}
      body={(form) => ({ texts: names(form.get("names")) })}
      result={outcome}
      onDone={onDone}
    >
      <label>
        {texts.lookAgain.names}
        <input name="names" required autocomplete="off" defaultValue={word} />
      </label>
    </SceneOrder>
  );
}

function names(field: FormDataEntryValue | null): string[] {
  return (typeof field === "string" ? field : "")
    .split(",")
    .map((name) => name.trim())
    .filter(Boolean);
}

function outcome({ look_again: result }: Operation) {
  if (!result) return null;
  const named = result.named.map((each) => each.name);
  const suggested = result.suggested.map((each) => each.name);
  return (
    <>
      {named.length > 0 && <p>{texts.lookAgain.named(named.join(", "))}</p>}
      {suggested.length > 0 && <p>{texts.lookAgain.suggested(suggested.join(", "))}</p>}
      {named.length + suggested.length === 0 && <p>{texts.lookAgain.nothing}</p>}
    </>
  );
}

import { useEffect, useRef, useState } from "preact/hooks";

import { renameScene } from "../api/adminCalls";
import { ApiError } from "../api/http";
import type { Scene } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import { ErrorNote } from "../ui/parts";

/** The scene's name as the page's heading, edited in place. What somebody else has named meanwhile is not overwritten. */
export function SceneName({ scene, onChange }: { scene: Scene; onChange: () => Promise<void> }) {
  const [typed, setTyped] = useState<string | null>(null);
  const [error, setError] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const field = useRef<HTMLInputElement>(null);
  const opener = useRef<HTMLButtonElement>(null);
  const wasOpen = useRef(false);
  const open = typed !== null;

  useEffect(() => {
    if (open) field.current?.select();
    else if (wasOpen.current) opener.current?.focus();
    wasOpen.current = open;
  }, [open]);

  const close = () => {
    setTyped(null);
    setError(null);
  };
  const save = async () => {
    const name = (typed ?? "").trim();
    if (name === scene.name) {
      close();
      return;
    }
    setBusy(true);
    setError(null);
    try {
      await renameScene(scene.id, name, scene.name);
      await onChange();
      close();
    } catch (problem) {
      setError(problem);
      if (problem instanceof ApiError && problem.field === "expected_name") await onChange();
    } finally {
      setBusy(false);
    }
  };

  const heading = <h1>{scene.name || texts.scenes.untitled}</h1>;
  if (!open)
    return (
      <div class="title-row">
        {heading}
        <button type="button" class="plain" ref={opener} onClick={() => setTyped(scene.name)}>
          {texts.sceneName.edit}
        </button>
      </div>
    );
  return (
    <>
      {heading}
      <Form
        onSubmit={() => void save()}
        onKeyDown={(event) => {
          if (event.key === "Escape") close();
        }}
      >
        <label>
          {texts.sceneName.label}
          <input
            ref={field}
            value={typed}
            autocomplete="off"
            onInput={(event) => setTyped(event.currentTarget.value)}
          />
        </label>
        {error !== null && <ErrorNote error={error} />}
        <div class="buttons">
          <Button type="submit" class="primary" disabled={busy} text={texts.sceneName.save} />
          <Button onClick={close} text={texts.cancel} />
        </div>
      </Form>
    </>
  );
}

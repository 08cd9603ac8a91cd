import { useState } from "preact/hooks";

import { sceneAddress } from "../address/router";
import { deleteKnownName, listKnownNames } from "../api/serverCalls";
import { texts } from "../texts";
import { momentText } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";

/** What people named in the project's scenes and is suggested in others. */
export function KnownNamePanel({ canDelete }: { canDelete: boolean }) {
  const { value, error, reload } = useLoaded(listKnownNames, []);
  const [failure, setFailure] = useState<unknown>(null);
  const problem = error ?? failure;
  return (
    <section class="server-part" aria-labelledby="names-title">
      <h2 id="names-title">{texts.server.names}</h2>
      <p class="hint">{texts.server.namesHelp}</p>
      {problem !== null && <ErrorNote error={problem} />}
      {value?.length === 0 && <p class="hint">{texts.server.noNames}</p>}
      <ul class="rows names" aria-label={texts.server.names}>
        {value?.map((name) => (
          <li key={name.id}>
            {name.picture && <img src={`data:image/jpeg;base64,${name.picture}`} alt="" width="48" height="48" />}
            <span class="row-name">
              <a href={sceneAddress(name.scene_id, { text: name.name })}>{name.name}</a>
            </span>
            <span class="hint">{momentText(name.named_at)}</span>
            {canDelete && (
              <Button
                class="danger"
                aria-label={texts.server.forgetOf(name.name)}
                onClick={() => {
                  setFailure(null);
                  deleteKnownName(name.id).then(reload, setFailure);
                }}
                text={texts.server.forget}
              />
            )}
          </li>
        ))}
      </ul>
    </section>
  );
}

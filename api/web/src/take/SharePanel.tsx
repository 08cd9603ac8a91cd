import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";

import { sceneAddress } from "../address/addresses";
import { mayDo } from "../api/roles";
import { serverStatus } from "../api/serverCalls";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { CopyField } from "../ui/CopyField";
import { Form } from "../ui/fields";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { createShare, listShares, revokeShare } from "./shareCalls";

const DAYS = [1, 7, 30, 365];

interface Properties {
  sceneId: string;
  /** What saves the scene as one file, where no link can be made. */
  instead: ComponentChildren;
}

/** Links that show this scene, read-only, to whoever has one; or why none can be made here, and what to send instead. */
export function SharePanel({ sceneId, instead }: Properties) {
  const { value: status } = useLoaded(serverStatus, []);
  if (!status) return null;
  const allowed = status.asks_for_keys && mayDo(status.role, "admin");
  return (
    <section class="share" aria-labelledby="share-title">
      <h2 id="share-title">{texts.take.share}</h2>
      {allowed ? (
        <Links sceneId={sceneId} />
      ) : (
        <>
          <p class="hint">{status.asks_for_keys ? texts.take.adminsLink : texts.take.noLink}</p>
          {instead}
        </>
      )}
    </section>
  );
}

/** Links are made, listed, taken back. */
function Links({ sceneId }: { sceneId: string }) {
  const links = useLoaded((signal) => listShares(sceneId, signal), [sceneId]);
  const [name, setName] = useState("");
  const [days, setDays] = useState(7);
  const [link, setLink] = useState("");
  const [error, setError] = useState<unknown>(null);
  const attempt = (call: () => Promise<unknown>) => {
    setError(null);
    call().then(links.reload, setError);
  };
  const create = () =>
    attempt(async () => {
      const made = await createShare(sceneId, name.trim() || texts.take.link, days);
      const page = location.href.replace(/#.*$/, "");
      setLink(`${page}${sceneAddress(sceneId, { share: made.secret })}`);
    });
  return (
    <>
      <p class="hint">{texts.take.shareHelp}</p>
      <Form onSubmit={() => create()}>
        <label>
          {texts.take.forWhom}
          <input
            value={name}
            maxLength={200}
            autocomplete="off"
            onInput={(event) => setName(event.currentTarget.value)}
          />
        </label>
        <label>
          {texts.take.validFor}
          <select value={days} onChange={(event) => setDays(Number(event.currentTarget.value))}>
            {DAYS.map((count) => (
              <option key={count} value={count}>
                {texts.take.days(count)}
              </option>
            ))}
          </select>
        </label>
        <Button type="submit" class="primary" text={texts.take.makeLink} />
      </Form>
      {error !== null && <ErrorNote error={error} />}
      {link && (
        <div class="note" role="status">
          <CopyField label={texts.take.newLink} text={link} />
        </div>
      )}
      {links.error !== null && <ErrorNote error={links.error} />}
      {links.value !== null && links.value.length > 0 && (
        <ul class="share-list">
          {links.value.map((key) => (
            <li key={key.id}>
              <span>
                {key.name} <span class="hint">{texts.take.state(key.state, key.expires_at)}</span>
              </span>
              {key.state === "VALID" && (
                <Button
                  aria-label={texts.take.revokeLink(key.name)}
                  onClick={() => attempt(() => revokeShare(key.id))}
                  text={texts.take.revoke}
                />
              )}
            </li>
          ))}
        </ul>
      )}
    </>
  );
}

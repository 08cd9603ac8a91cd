import { useState } from "preact/hooks";

import { sceneAddress } from "../address/addresses";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { createShare, listShares, revokeShare } from "./shareCalls";

const DAYS = [1, 7, 30, 365];

/** Links that show this scene, read-only, to whoever has one: made, listed, taken back. */
export function SharePanel({ sceneId }: { sceneId: string }) {
  const links = useLoaded((signal) => listShares(sceneId, signal), [sceneId]);
  const [name, setName] = useState("");
  const [days, setDays] = useState(7);
  const [link, setLink] = useState("");
  const [error, setError] = useState<unknown>(null);
  const [copied, setCopied] = useState(false);
  const attempt = (call: () => Promise<unknown>) => {
    setError(null);
    call().then(links.reload, setError);
  };
  const create = () =>
    attempt(async () => {
      const made = await createShare(sceneId, name.trim() || texts.take.link, days);
      const page = location.href.replace(/#.*$/, "");
      setLink(`${page}${sceneAddress(sceneId, { share: made.secret })}`);
      setCopied(false);
    });
  return (
    <section class="share" aria-labelledby="share-title">
      <h2 id="share-title">{texts.take.share}</h2>
      <p class="hint">{texts.take.shareHelp}</p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          create();
        }}
      >
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
        <button class="primary">{texts.take.makeLink}</button>
      </form>
      {error !== null && <ErrorNote error={error} />}
      {link && (
        <div class="note" role="status">
          <label>
            {texts.take.newLink}
            <input readOnly value={link} onFocus={(event) => event.currentTarget.select()} />
          </label>
          <button
            type="button"
            onClick={() => {
              navigator.clipboard.writeText(link).then(() => setCopied(true), setError);
            }}
          >
            {copied ? texts.take.copied : texts.take.copy}
          </button>
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
                <button
                  type="button"
                  aria-label={texts.take.revokeLink(key.name)}
                  onClick={() => attempt(() => revokeShare(key.id))}
                >
                  {texts.take.revoke}
                </button>
              )}
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}

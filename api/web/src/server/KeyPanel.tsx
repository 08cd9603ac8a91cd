import { useRef, useState } from "preact/hooks";

import { rolesUpTo } from "../api/roles";
import { createKey, listKeys, revokeKey } from "../api/serverCalls";
import type { AccessKey, NewKey, Role } from "../api/types";
import { texts } from "../texts";
import { momentText } from "../texts/figures";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";

const DAY_S = 86_400;
const LIFETIMES = { never: null, day: DAY_S, month: 30 * DAY_S, year: 365 * DAY_S };
type Lifetime = keyof typeof LIFETIMES;

/** The project's keys: made here, shown once, taken back after a second question. */
export function KeyPanel({ role }: { role: Role }) {
  const { value, error, reload } = useLoaded(listKeys, []);
  const [failure, setFailure] = useState<unknown>(null);
  const [made, setMade] = useState<NewKey | null>(null);
  const [all, setAll] = useState(false);
  const form = useRef<HTMLFormElement>(null);
  const create = async () => {
    const data = new FormData(form.current ?? undefined);
    setFailure(null);
    try {
      const lifetime = LIFETIMES[data.get("lifetime") as Lifetime];
      setMade(await createKey((data.get("name") as string).trim(), data.get("role") as Role, lifetime));
      form.current?.reset();
      reload();
    } catch (problem) {
      setFailure(problem);
    }
  };
  const shown = value?.filter((key) => all || key.state === "VALID") ?? [];
  const problem = error ?? failure;
  return (
    <section class="server-part" aria-labelledby="keys-title">
      <h2 id="keys-title">{texts.server.keys}</h2>
      {problem !== null && <ErrorNote error={problem} />}
      {made && <Made key={made.key.id} made={made} onClose={() => setMade(null)} />}
      <form
        ref={form}
        onSubmit={(event) => {
          event.preventDefault();
          void create();
        }}
      >
        <label>
          {texts.server.keyName}
          <input name="name" required maxLength={200} autocomplete="off" />
        </label>
        <label>
          {texts.server.keyRole}
          <select name="role">
            {rolesUpTo(role).map((each) => (
              <option key={each} value={each} selected={each === "editor"}>
                {texts.server.roles[each]}: {texts.server.roleMeans[each]}
              </option>
            ))}
          </select>
        </label>
        <label>
          {texts.server.keyLifetime}
          <select name="lifetime">
            {(Object.keys(LIFETIMES) as Lifetime[]).map((each) => (
              <option key={each} value={each}>
                {texts.server.lifetimes[each]}
              </option>
            ))}
          </select>
        </label>
        <div class="buttons">
          <button class="primary">{texts.server.createKey}</button>
        </div>
      </form>
      <label class="check">
        <input type="checkbox" checked={all} onChange={(event) => setAll(event.currentTarget.checked)} />
        {texts.server.allKeys}
      </label>
      <ul class="rows" aria-label={texts.server.keys}>
        {shown.map((key) => (
          <Key
            key={key.id}
            accessKey={key}
            onRevoke={() => {
              setFailure(null);
              revokeKey(key.id).then(reload, setFailure);
            }}
          />
        ))}
      </ul>
    </section>
  );
}

function Made({ made, onClose }: { made: NewKey; onClose: () => void }) {
  const [copied, setCopied] = useState(false);
  return (
    <div class="note" role="group" aria-label={texts.server.newKey(made.key.name)}>
      <p role="status">{texts.server.newKey(made.key.name)}</p>
      <label>
        {texts.server.secret}
        <input readOnly value={made.secret} onFocus={(event) => event.currentTarget.select()} />
      </label>
      <div class="buttons">
        {window.isSecureContext && ( // elsewhere there is no clipboard
          <button
            type="button"
            onClick={() => {
              navigator.clipboard.writeText(made.secret).then(
                () => setCopied(true),
                () => undefined, // it can still be selected
              );
            }}
          >
            {copied ? texts.server.copied : texts.server.copy}
          </button>
        )}
        <button type="button" onClick={onClose}>
          {texts.server.stored}
        </button>
      </div>
    </div>
  );
}

function Key({ accessKey, onRevoke }: { accessKey: AccessKey; onRevoke: () => void }) {
  const [asked, setAsked] = useState(false);
  const about = [
    texts.server.roles[accessKey.role],
    texts.server.made(momentText(accessKey.created_at)),
    accessKey.expires_at ? texts.server.until(momentText(accessKey.expires_at)) : texts.server.forever,
    accessKey.operation_id && texts.server.usedUp,
    accessKey.id,
  ];
  return (
    <li>
      <span class="row-name">{accessKey.name}</span>
      <span class={`state ${accessKey.state === "VALID" ? "ready" : "failed"}`}>
        {texts.server.keyStates[accessKey.state]}
      </span>
      <span class="hint">{about.filter(Boolean).join(" · ")}</span>
      {accessKey.state === "VALID" &&
        (asked ? (
          <span class="buttons">
            <button type="button" class="danger" onClick={onRevoke}>
              {texts.server.revokeYes}
            </button>
            <button type="button" onClick={() => setAsked(false)}>
              {texts.cancel}
            </button>
          </span>
        ) : (
          <button
            type="button"
            class="danger"
            aria-label={texts.server.revokeOf(accessKey.name)}
            onClick={() => setAsked(true)}
          >
            {texts.server.revoke}
          </button>
        ))}
    </li>
  );
}

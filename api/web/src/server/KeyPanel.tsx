import { useState } from "preact/hooks";

import { rolesUpTo } from "../api/roles";
import { createKey, listKeys, revokeKey } from "../api/serverCalls";
import type { AccessKey, NewKey, Role } from "../api/types";
import { texts } from "../texts";
import { momentText } from "../texts/figures";
import { Button } from "../ui/Button";
import { CopyField } from "../ui/CopyField";
import { Check, Form } from "../ui/fields";
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
  const create = async (form: HTMLFormElement) => {
    const data = new FormData(form);
    setFailure(null);
    try {
      const lifetime = LIFETIMES[data.get("lifetime") as Lifetime];
      setMade(await createKey((data.get("name") as string).trim(), data.get("role") as Role, lifetime));
      form.reset();
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
      <Form onSubmit={(form) => void create(form)}>
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
          <Button type="submit" class="primary" text={texts.server.createKey} />
        </div>
      </Form>
      <Check label={texts.server.allKeys} checked={all} onChange={setAll} />
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
  return (
    <div class="note" role="group" aria-label={texts.server.newKey(made.key.name)}>
      <p role="status">{texts.server.newKey(made.key.name)}</p>
      <CopyField label={texts.server.secret} text={made.secret}>
        <Button onClick={onClose} text={texts.server.stored} />
      </CopyField>
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
            <Button class="danger" onClick={onRevoke} text={texts.server.revokeYes} />
            <Button onClick={() => setAsked(false)} text={texts.cancel} />
          </span>
        ) : (
          <Button
            class="danger"
            aria-label={texts.server.revokeOf(accessKey.name)}
            onClick={() => setAsked(true)}
            text={texts.server.revoke}
          />
        ))}
    </li>
  );
}

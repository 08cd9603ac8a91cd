import { useEffect, useRef } from "preact/hooks";

import { signIn, signInReason } from "../api/http";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";

export function SignIn() {
  const field = useRef<HTMLInputElement>(null);
  useEffect(() => field.current?.focus(), []);
  const refused = signInReason.value === "refused";
  return (
    <section class="sheet">
      <h1>{texts.signIn.title}</h1>
      {refused ? (
        <p class="note error" role="alert">
          {texts.signIn.refused}
        </p>
      ) : (
        <p>{texts.signIn.missing}</p>
      )}
      <Form
        onSubmit={() => {
          const key = field.current?.value.trim();
          if (key) signIn(key);
        }}
      >
        <label>
          {texts.signIn.key}
          <input
            ref={field}
            type="password"
            name="key"
            required
            autocomplete="current-password"
            aria-describedby="key-help"
          />
        </label>
        <p id="key-help" class="hint">
          {texts.signIn.where} {texts.signIn.remember}
        </p>
        <Button type="submit" class="primary" text={texts.signIn.submit} />
      </Form>
    </section>
  );
}

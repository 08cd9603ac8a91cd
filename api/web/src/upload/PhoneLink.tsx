import { useState } from "preact/hooks";

import { isLoopback, linkFor } from "../address/uploadLink";
import { createUploadKey } from "../api/serverCalls";
import type { NewKey } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { CopyField } from "../ui/CopyField";
import { ErrorNote } from "../ui/parts";
import { QrCode } from "./QrCode";

/** A link for one upload, as QR code: the phone that opens it may post one scene, and nothing else. */
export function PhoneLink({ addresses }: { addresses: readonly string[] }) {
  const [made, setMade] = useState<{ key: NewKey; link: string } | null>(null);
  const [error, setError] = useState<unknown>(null);
  const here = location.href.replace(/#.*$/, "");
  const reachable = isLoopback(location.hostname) ? addresses : [here];
  const make = (page: string) => {
    setError(null);
    createUploadKey().then((key) => setMade({ key, link: linkFor(page, key.secret) }), setError);
  };
  const expires = made?.key.key.expires_at;
  return (
    <section class="phone" aria-labelledby="phone-title">
      <h2 id="phone-title">{texts.phone.title}</h2>
      {reachable[0] !== here && (
        <p class="note">
          {texts.phone.localhost(location.hostname)}{" "}
          {reachable.length > 0 ? texts.phone.otherAddress : texts.phone.noAddress}
        </p>
      )}
      {error !== null && <ErrorNote error={error} />}
      {!made && (
        <div class="buttons">
          {reachable.map((page) => (
            <Button
              key={page}
              onClick={() => make(page)}
              text={page === here ? texts.phone.make : texts.phone.makeFor(page)}
            />
          ))}
        </div>
      )}
      {made && (
        <>
          <QrCode text={made.link} title={texts.phone.code} />
          <p role="status">
            {texts.phone.scan}{" "}
            {expires && texts.phone.valid(new Date(expires).toLocaleTimeString("en", { timeStyle: "short" }))}
          </p>
          <CopyField label={texts.phone.link} text={made.link}>
            <Button onClick={() => setMade(null)} text={texts.phone.another} />
          </CopyField>
        </>
      )}
    </section>
  );
}

import { useEffect, useRef } from "preact/hooks";

import { route } from "../address/router";
import { isShared } from "../address/share";
import { accessKey, isOnline, signInReason, signOut } from "../api/http";
import { ScenePage } from "../scene/ScenePage";
import { ScenesPage } from "../scenes/ScenesPage";
import { ServerPage } from "../server/ServerPage";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { LeftUploads } from "../upload/LeftUploads";
import { PhonePage } from "../upload/PhonePage";
import { UploadPage } from "../upload/UploadPage";
import { SignIn } from "./SignIn";

/** The whole page: the header, and what the address names. */
export function App() {
  const phone = route.value.page === "phone"; // a key for one upload opens no other page
  const signedOut = signInReason.value !== "" && !phone;
  return (
    <>
      <a class="skip" href="#content">
        {texts.skip}
      </a>
      <header>
        <a class="brand" href={isShared ? undefined : phone ? "#/phone" : "#/"}>
          <img src="web/icon.svg" alt="" width="24" height="24" />
          {texts.product}
        </a>
        <nav aria-label={texts.nav.label}>
          {!signedOut && !isShared && !phone && (
            <>
              <a href="#/" aria-current={route.value.page === "scenes" ? "page" : undefined}>
                {texts.nav.scenes}
              </a>
              <a href="#/new" aria-current={route.value.page === "new" ? "page" : undefined}>
                {texts.nav.newScene}
              </a>
              <a href="#/server" aria-current={route.value.page === "server" ? "page" : undefined}>
                {texts.server.title}
              </a>
            </>
          )}
          {!phone && <a href="docs">{texts.nav.api}</a>}
          {accessKey.value && !signedOut && !isShared && !phone && (
            <Button class="plain" onClick={signOut} text={texts.nav.signOut} />
          )}
        </nav>
      </header>
      {!isOnline.value && (
        <p class="note offline" role="status">
          {texts.errors.offlineNow}
        </p>
      )}
      {!signedOut && <LeftUploads />}
      <Content signedOut={signedOut} />
    </>
  );
}

function Content({ signedOut }: { signedOut: boolean }) {
  const main = useRef<HTMLElement>(null);
  const current = route.value;
  const place = current.page === "scene" ? `scene ${current.sceneId}` : current.page;
  const before = useRef(place);
  useEffect(() => {
    if (before.current !== place) main.current?.focus(); // the link that was followed is gone
    before.current = place;
  }, [place]);
  return (
    <main id="content" tabIndex={-1} ref={main}>
      {!signedOut ? <Page /> : isShared ? <LinkEnded /> : <SignIn />}
    </main>
  );
}

function LinkEnded() {
  return (
    <section class="sheet">
      <h1>{texts.take.ended}</h1>
      <p>{texts.take.endedText}</p>
    </section>
  );
}

function Page() {
  const current = route.value;
  switch (current.page) {
    case "scenes":
      return <ScenesPage />;
    case "new":
      return <UploadPage />;
    case "phone":
      return <PhonePage />;
    case "server":
      return <ServerPage />;
    case "scene":
      return <ScenePage key={current.sceneId} sceneId={current.sceneId} />;
    case "unknown":
      return (
        <section class="sheet">
          <h1>{texts.unknownPage.title}</h1>
          <p>{texts.unknownPage.text}</p>
          <a href="#/">{texts.unknownPage.back}</a>
        </section>
      );
  }
}

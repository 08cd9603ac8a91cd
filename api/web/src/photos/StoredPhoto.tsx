import { useEffect, useRef, useState } from "preact/hooks";

import { photoAddress } from "../api/photoCalls";

/** A photo that is stored with a scene, small, with a caption if it has one; loaded when it comes into sight. */
export function StoredPhoto({ sceneId, view, caption }: { sceneId: string; view: string; caption: string }) {
  const [address, setAddress] = useState("");
  const picture = useRef<HTMLImageElement>(null);
  useEffect(() => {
    const observer = new IntersectionObserver((entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      photoAddress(sceneId, "", view, true).then(setAddress, () => undefined); // its name stands beside it
    });
    if (picture.current) observer.observe(picture.current);
    return () => observer.disconnect();
  }, [sceneId, view]);
  return (
    <figure class="stored-photo">
      <img ref={picture} src={address || undefined} alt="" />
      {caption && <figcaption class="hint">{caption}</figcaption>}
    </figure>
  );
}

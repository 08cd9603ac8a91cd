import { useEffect, useRef } from "preact/hooks";

import { renderPicture } from "../api/calls";
import { photoAddress } from "../api/photoCalls";
import type { Observation } from "../api/types";
import { texts } from "../texts";
import type { Crop } from "./changeCrop";
import { cropOf, reduced } from "./changeCrop";

const SIDE = 140; // pixels
const RENDERED = 480;

type Change = Observation["changes"][number];
interface Props {
  sceneId: string;
  version: string;
  observation: Observation;
  change: Change;
}

/** One change as the scene shows its place and as a photo does, from where that was taken. */
export function ChangePictures({ sceneId, version, observation, change }: Props) {
  const photo = change.photos.map((number) => observation.photos[number]).find((each) => each && placeIn(each, change));
  const crop = photo && placeIn(photo, change);
  if (!photo || !crop) return null;
  const before = async (signal: AbortSignal) =>
    URL.createObjectURL(await renderPicture(sceneId, reduced(photo.camera, RENDERED), signal, { version }));
  return (
    <div class="change-pictures">
      <Picture caption={texts.observe.before} crop={crop} address={before} own />
      {photo.view && (
        <Picture
          caption={texts.observe.after}
          crop={crop}
          address={() => photoAddress(sceneId, version, photo.view, true)}
        />
      )}
    </div>
  );
}

const placeIn = (photo: Observation["photos"][number], { before, after }: Change) => {
  const box = before ?? after;
  return box && cropOf(photo.camera, box);
};

interface PictureProps {
  caption: string;
  crop: Crop;
  address: (signal: AbortSignal) => Promise<string>;
  /** Whether nobody else uses the address. */
  own?: boolean;
}

function Picture({ caption, crop, address, own = false }: PictureProps) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const controller = new AbortController();
    const draw = async () => {
      const picture = new Image();
      picture.src = await address(controller.signal);
      await picture.decode();
      if (own) URL.revokeObjectURL(picture.src);
      const [left, top, side] = [crop.left, crop.top, crop.side].map((share) => share * picture.naturalWidth);
      const context = controller.signal.aborted ? null : canvas.current?.getContext("2d");
      context?.drawImage(picture, left ?? 0, top ?? 0, side ?? 0, side ?? 0, 0, 0, SIDE, SIDE);
      if (canvas.current) canvas.current.dataset.drawn = "";
    };
    draw().catch(() => undefined); // the sentence says what has changed
    return () => controller.abort();
  }, []); // eslint-disable-line react-hooks/exhaustive-deps -- a change never changes
  return (
    <figure>
      <canvas ref={canvas} width={SIDE} height={SIDE} aria-hidden="true" />
      <figcaption class="hint">{caption}</figcaption>
    </figure>
  );
}

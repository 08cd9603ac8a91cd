import { useEffect, useRef, useState } from "preact/hooks";

import { getJson, isAbort } from "../api/http";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import type { Vec } from "../viewer/vectors";
import type { PlacedCameras, PlacedScene } from "./placedScene";
import { axesOfTurn, placedScene, projected } from "./placedScene";

type Info = NonNullable<Operation["placed"]>;

const TILT = 0.45;
const STEP = Math.PI / 12;
const RADIANS_PER_PIXEL = 0.01;
const SIZE = 640; // pixels of the drawing, scaled by the style sheet
const MARGIN = 0.47;

/** The cameras that a job has placed and some of its points, as a drawing that can be turned. */
export function PlacedView({ operationId, info }: { operationId: string; info: Info }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [scene, setScene] = useState<PlacedScene | null>(null);
  const [turn, setTurn] = useState(0.6);
  useEffect(() => {
    const controller = new AbortController();
    getJson<PlacedCameras>(`v1/operations/${encodeURIComponent(operationId)}/cameras`, controller.signal).then(
      (placed) => setScene(placedScene(placed)),
      (error: unknown) => {
        if (!isAbort(error)) setScene((before) => before); // the next change will do
      },
    );
    return () => controller.abort();
  }, [operationId, info.number]);
  useEffect(() => {
    const context = canvas.current?.getContext("2d");
    if (context && scene) draw(context, scene, turn);
  }, [scene, turn]);
  return (
    <figure class="job-figure">
      <canvas
        ref={canvas}
        class="placed"
        width={SIZE}
        height={SIZE}
        role="img"
        aria-label={texts.jobWatching.camerasAlt(info.placed, info.images)}
        data-cameras={scene?.frusta.length ?? 0}
        data-points={(scene?.points.length ?? 0) / 3}
        onPointerDown={(event) => event.currentTarget.setPointerCapture(event.pointerId)}
        onPointerMove={(event) => {
          if (event.buttons) setTurn((before) => before - event.movementX * RADIANS_PER_PIXEL);
        }}
      />
      <figcaption class="hint">{texts.jobWatching.placed(info.placed, info.images)}</figcaption>
      <span class="buttons">
        <Button onClick={() => setTurn((before) => before - STEP)} text={texts.jobWatching.turnLeft} />
        <Button onClick={() => setTurn((before) => before + STEP)} text={texts.jobWatching.turnRight} />
      </span>
    </figure>
  );
}

function draw(context: CanvasRenderingContext2D, scene: PlacedScene, turn: number): void {
  const { canvas } = context;
  const axes = axesOfTurn(scene.up, turn, TILT);
  const [middle, reach] = [canvas.width / 2, canvas.width * MARGIN];
  const place = (point: Vec): readonly [number, number] => {
    const [x, y] = projected(point, axes);
    return [middle + x * reach, middle + y * reach];
  };
  context.clearRect(0, 0, canvas.width, canvas.height);
  for (let row = 0; row * 3 < scene.points.length; row += 1) {
    const [a, b, c] = [3 * row, 3 * row + 1, 3 * row + 2];
    const [x, y] = place([scene.points[a] ?? 0, scene.points[b] ?? 0, scene.points[c] ?? 0]);
    context.fillStyle = `rgb(${scene.colors[a] ?? 0} ${scene.colors[b] ?? 0} ${scene.colors[c] ?? 0})`;
    context.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  context.strokeStyle = getComputedStyle(canvas).color;
  context.lineWidth = 1.5;
  for (const [center, ...corners] of scene.frusta) {
    if (!center) continue;
    context.beginPath();
    const last = corners.at(-1);
    if (last) context.moveTo(...place(last));
    for (const corner of corners) context.lineTo(...place(corner));
    for (const corner of corners) {
      context.moveTo(...place(center));
      context.lineTo(...place(corner));
    }
    context.stroke();
  }
}

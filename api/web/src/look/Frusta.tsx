import { useMemo } from "preact/hooks";

import type { LookState } from "../state/lookState";
import { texts } from "../texts";
import { drawnDepth, frustumOf, pathPoint, Projection } from "../viewer/projection";
import { length, subtract } from "../viewer/vectors";

const HANDLE = 12; // pixels: what a finger can hit

/** Cameras as pyramids over the 3D view; no lines of the engine, as splats write no depth. By keyboard: the menu. */
export function Frusta({ look }: { look: LookState }) {
  const cameras = look.all.value;
  const shapes = useMemo(() => {
    const depth = drawnDepth(cameras);
    return cameras.map((camera) => ({ name: camera.name, depth, ...frustumOf(camera, depth) }));
  }, [cameras]);
  const [view, size] = [look.view.value, look.size.value];
  if (!look.cameras.value || look.standing.value || !view || !size.width) return null;
  const projection = new Projection(view, size);
  return (
    <svg class="frusta" viewBox={`0 0 ${size.width} ${size.height}`} aria-hidden="true">
      {shapes.map(({ name, depth, apex, corners: [a, b, c, d] }, index) => {
        if (length(subtract(apex, view.position)) < depth) return null; // the view is inside it
        const edges = [
          [a, b],
          [b, c],
          [c, d],
          [d, a],
          [apex, a],
          [apex, b],
          [apex, c],
          [apex, d],
        ] as const;
        const lines = edges.map(([from, to]) => projection.line(from, to)).filter((line) => line !== null);
        if (lines.length === 0) return null;
        const tip = projection.line(apex, apex);
        const path = lines.map(([from, to]) => `M${pathPoint(from)}L${pathPoint(to)}`).join("");
        return (
          <g key={index} class={name === look.at.value ? "present" : ""} data-camera={name}>
            <path class="halo" d={path} />
            <path d={path} />
            {tip && (
              <g class="handle" onClick={() => look.goTo(name)}>
                <title>{texts.look.flyTo(name)}</title>
                <circle class="hit" cx={tip[0][0]} cy={tip[0][1]} r={HANDLE} />
                <circle cx={tip[0][0]} cy={tip[0][1]} r={4} />
              </g>
            )}
          </g>
        );
      })}
    </svg>
  );
}

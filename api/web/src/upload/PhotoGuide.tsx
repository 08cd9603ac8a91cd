import { texts } from "../texts";

const COUNT = 20;
const [MIDDLE_X, MIDDLE_Y] = [120, 86];

/** A camera as seen from above: it stands at a place of a ring around the object, and looks at it. */
function Camera({ angle, reach }: { angle: number; reach: number }) {
  const x = MIDDLE_X + reach * Math.cos(angle);
  const y = MIDDLE_Y + 0.62 * reach * Math.sin(angle);
  const turn = (Math.atan2(MIDDLE_Y - y, MIDDLE_X - x) * 180) / Math.PI;
  return (
    <g transform={`translate(${x.toFixed(1)} ${y.toFixed(1)}) rotate(${turn.toFixed(1)})`}>
      <path class="sight" d="M0 0 26 -11 26 11Z" />
      <rect x="-5" y="-4" width="8" height="8" rx="1.5" />
    </g>
  );
}

/** What 20 good photos look like: a walk around the object in small steps, in two rounds of different height. */
export function PhotoGuide() {
  return (
    <figure class="photo-guide">
      <svg viewBox="0 0 240 172" role="img" aria-label={texts.upload.guidePicture}>
        <ellipse class="ring" cx={MIDDLE_X} cy={MIDDLE_Y} rx="104" ry="64.5" />
        <ellipse class="ring" cx={MIDDLE_X} cy={MIDDLE_Y} rx="72" ry="44.6" />
        {Array.from({ length: COUNT }, (_, number) => (
          <Camera
            key={number}
            angle={(2 * Math.PI * (number + (number % 2) / 2)) / COUNT}
            reach={number % 2 ? 72 : 104}
          />
        ))}
        <path class="object" d="M108 80 120 73 132 80 132 94 120 101 108 94ZM108 80 120 87 132 80M120 87V101" />
      </svg>
      <figcaption>
        <ul>
          {texts.upload.guide.map((rule) => (
            <li key={rule}>{rule}</li>
          ))}
        </ul>
      </figcaption>
    </figure>
  );
}

import { useEffect, useState } from "preact/hooks";

const QUIET_ZONE = 4; // modules, ISO/IEC 18004

/** A text as QR code: black on white whatever the color scheme, as readers want it. */
export function QrCode({ text, title }: { text: string; title: string }) {
  const [modules, setModules] = useState<boolean[][] | null>(null);
  useEffect(() => {
    let current = true;
    void import("uqr").then(({ encode }) => {
      if (current) setModules(encode(text, { ecc: "M", border: 0 }).data);
    });
    return () => {
      current = false;
    };
  }, [text]);
  if (!modules) return null;
  const side = modules.length + 2 * QUIET_ZONE;
  const path = modules
    .flatMap((row, y) => row.map((dark, x) => (dark ? `M${x + QUIET_ZONE} ${y + QUIET_ZONE}h1v1h-1z` : "")))
    .join("");
  return (
    <svg class="qr" viewBox={`0 0 ${side} ${side}`} role="img" aria-label={title} shape-rendering="crispEdges">
      <rect width={side} height={side} fill="#fff" />
      <path d={path} fill="#000" />
    </svg>
  );
}

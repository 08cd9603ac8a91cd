/** What draws on a canvas, or null where this browser cannot; made once, since that takes long. */
export function webgl(canvas: HTMLCanvasElement): WebGL2RenderingContext | null {
  return canvas.getContext("webgl2", { stencil: true, antialias: false, powerPreference: "high-performance" });
}

import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { join } from "node:path";

import type { Plugin } from "vite";
import { defineConfig } from "vite";

const SCENE = "<!--scene-->"; // the server puts the scene's data here: service/application/exporting/scene_page.py

const sha256 = (text: string): string => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;
const inScript = (text: string): string => text.replace(/<\/(script)/gi, "<\\/$1").replace(/<!--/g, "<\\!--");

/** Writes `offline.html`: one file with script and styles in it, which may load nothing and runs nothing else. */
function singleFile(): Plugin {
  return {
    name: "single-file",
    enforce: "post",
    generateBundle(_, bundle) {
      let [script, style] = ["", ""];
      for (const [name, part] of Object.entries(bundle)) {
        if (part.type === "chunk") script += part.code;
        else if (name.endsWith(".css")) style += String(part.source);
        else if (!name.endsWith(".html")) this.error(`${name} cannot be in one file`);
        Reflect.deleteProperty(bundle, name);
      }
      script = inScript(script);
      const policy = [
        "default-src 'none'",
        `script-src ${sha256(script)}`,
        "worker-src blob:",
        "img-src data: blob:",
        `style-src ${sha256(style)}`,
        "form-action 'none'",
        "base-uri 'none'",
      ].join("; ");
      const licenses = readFileSync(join(import.meta.dirname, "dist", "licenses.txt"), "utf8");
      const html = readFileSync(join(import.meta.dirname, "offline.html"), "utf8")
        .replace("<head>", () => `<head>\n    <meta http-equiv="Content-Security-Policy" content="${policy}" />`)
        .replace("</head>", () => `  <style>${style}</style>\n  </head>`)
        .replace(
          /<script type="module".*<\/script>/,
          () =>
            `<script type="text/plain" id="licenses">\n${inScript(licenses)}\n</script>\n    ${SCENE}\n    <script>${script}</script>`,
        );
      this.emitFile({ type: "asset", fileName: "offline.html", source: html });
    },
  };
}

export default defineConfig({
  base: "./",
  publicDir: false,
  plugins: [singleFile()],
  esbuild: { jsx: "automatic", jsxImportSource: "preact" },
  build: {
    target: "es2022",
    emptyOutDir: false, // the page is there already
    modulePreload: false,
    cssCodeSplit: false,
    assetsInlineLimit: 1_000_000,
    chunkSizeWarningLimit: 4_000,
    rollupOptions: {
      input: "offline.html",
      output: { format: "iife", inlineDynamicImports: true },
    },
  },
});

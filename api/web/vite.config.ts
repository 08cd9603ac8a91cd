import { existsSync, readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";

import type { Plugin } from "vite";
import { defineConfig } from "vitest/config";

/** Writes `licenses.txt`: the licence texts of the packages whose code is in the bundle. */
function licenses(): Plugin {
  return {
    name: "licenses",
    generateBundle(_, bundle) {
      const folders = new Set<string>();
      for (const chunk of Object.values(bundle)) {
        if (chunk.type !== "chunk") continue;
        for (const id of Object.keys(chunk.modules)) {
          const match = /^.*\/node_modules\/(@[^/]+\/)?[^/]+/.exec(id.replace(/^\0/, ""));
          if (match) folders.add(match[0]);
        }
      }
      const texts = [...folders].sort().map((folder) => {
        const about = JSON.parse(readFileSync(join(folder, "package.json"), "utf8")) as Record<string, string>;
        const file = readdirSync(folder).find((name) => /^licen[cs]e/i.test(name));
        if (!file || !existsSync(join(folder, file))) this.error(`${about.name} is bundled and has no licence file`);
        return `${about.name} ${about.version} (${about.license})\n\n${readFileSync(join(folder, file), "utf8").trim()}\n`;
      });
      this.emitFile({ type: "asset", fileName: "licenses.txt", source: texts.join(`\n${"-".repeat(80)}\n\n`) });
    },
  };
}

export default defineConfig({
  // Relative addresses: a proxy may show the page under any path. The server has the built files at web/.
  base: "./",
  experimental: {
    renderBuiltUrl: (file, { hostType }) => (hostType === "html" ? `web/${file}` : { relative: true }),
  },
  plugins: [licenses()],
  esbuild: { jsx: "automatic", jsxImportSource: "preact" },
  build: {
    target: "es2022",
    // No file as a data: address, so that the content security policy need not allow it for scripts and styles.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 4_000,
  },
  server: { proxy: { "/v1": "http://127.0.0.1:8000", "/query": "http://127.0.0.1:8000" } },
  // One process and one set of modules for all tests: they are pure, and what one of them stubs is put back after it.
  test: {
    include: ["src/**/*.test.ts"],
    pool: "threads",
    isolate: false,
    fileParallelism: false,
    unstubGlobals: true,
    testTimeout: 120_000, // of the 200 gestures, on a machine that does other objects, too
  },
});

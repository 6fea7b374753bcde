import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { join, relative, sep } from "node:path";
import { gzipSync } from "node:zlib";
import { type Plugin, defineConfig } from "vite";

const here = import.meta.dirname;
const page = join(here, "..", "decomo_runtime", "view", "page");
const require = createRequire(import.meta.url);

/** The files that decide the page, in order of their paths; `tests/runtime/test_view_page.py` reads the same list. */
function sources(): string[] {
  const named = ["../decomo_runtime/expected_error.json", "index.html", "package-lock.json", "package.json", "tsconfig.json", "vite.config.ts"];
  const inSource = readdirSync(join(here, "src"), { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => relative(here, join(entry.parentPath, entry.name)).split(sep).join("/"));
  return [...named, ...inSource].sort();
}

const sha256 = (content: string | Uint8Array): string => createHash("sha256").update(content).digest("hex");

/** onnxruntime's binary, compressed: a third of the size on hosts that do not compress. The worker unpacks it. */
function runtimeBinary(): Plugin {
  return {
    name: "runtime-binary",
    generateBundle() {
      for (const [kind, fileName] of [["", "wasm"], [".jspi", "webgpu"]]) {
        const file = `onnxruntime-web/ort-wasm-simd-threaded${kind}`;
        const binary = gzipSync(readFileSync(require.resolve(`${file}.wasm`)), { level: 9 });
        this.emitFile({ type: "asset", fileName: `runtime/${fileName}.wasm.gz`, source: binary });
        const loader = readFileSync(require.resolve(`${file}.mjs`), "utf8").replace(/\n\/\/# sourceMappingURL=.*/, "");
        this.emitFile({ type: "asset", fileName: `runtime/${fileName}.mjs`, source: loader });
      }
    },
  };
}

const LIBRARIES = {
  "onnxruntime-web": {
    text: join(here, "src", "licences", "onnxruntime-web.txt"), // its package holds none
    source: "https://github.com/microsoft/onnxruntime; notices of what it is built from: ThirdPartyNotices.txt there",
  },
  fflate: { text: join(here, "node_modules", "fflate", "LICENSE"), source: "https://github.com/101arrowz/fflate" },
  "fast-png": { text: join(here, "node_modules", "fast-png", "LICENSE"), source: "https://github.com/image-js/fast-png" },
  iobuffer: { text: join(here, "node_modules", "iobuffer", "LICENSE"), source: "https://github.com/image-js/iobuffer" },
  "perfect-freehand": { text: join(here, "node_modules", "perfect-freehand", "LICENSE"), source: "https://github.com/steveruizok/perfect-freehand" },
  papaparse: { text: join(here, "node_modules", "papaparse", "LICENSE"), source: "https://github.com/mholt/PapaParse" },
  mediabunny: { text: join(here, "node_modules", "mediabunny", "LICENSE"), source: "https://github.com/Vanilagy/mediabunny" },
};

/** `licences.txt`: the libraries that the page contains, unchanged, and where their sources are. */
function licences(): Plugin {
  return {
    name: "licences",
    generateBundle() {
      const parts = Object.entries(LIBRARIES).map(([name, { text, source }]) => {
        const { version, license } = JSON.parse(readFileSync(join(here, "node_modules", name, "package.json"), "utf8"));
        return `${name} ${version} (${license}), source: ${source}\n\n${readFileSync(text, "utf8").trim()}\n`;
      });
      this.emitFile({ type: "asset", fileName: "licences.txt", source: parts.join(`\n${"-".repeat(80)}\n\n`) });
    },
  };
}

/** `build.json`: from which sources the page was built and what came out, so that a test needs no Node to compare. */
function digests(): Plugin {
  return {
    name: "digests",
    enforce: "post",
    generateBundle: {
      order: "post",
      handler(_options, bundle) {
        const content = sources().map((name) => `${name} ${sha256(readFileSync(join(here, name)))}\n`);
        const built = Object.values(bundle)
          .map((file) => [file.fileName, sha256(file.type === "chunk" ? file.code : file.source)] as const)
          .sort(([a], [b]) => (a < b ? -1 : 1));
        const record = { sources: sha256(content.join("")), files: Object.fromEntries(built) };
        this.emitFile({ type: "asset", fileName: "build.json", source: `${JSON.stringify(record, null, 2)}\n` });
      },
    },
  };
}

const stableNames = {
  entryFileNames: "assets/[name].js",
  chunkFileNames: "assets/[name].js",
  assetFileNames: "assets/[name][extname]",
};

export default defineConfig({
  root: here,
  base: "./",
  publicDir: false,
  resolve: { conditions: ["onnxruntime-web-use-extern-wasm", "module", "browser"] },
  build: {
    outDir: page,
    emptyOutDir: true,
    target: "es2023",
    modulePreload: false,
    assetsInlineLimit: 0,
    rolldownOptions: { output: stableNames },
  },
  worker: { format: "es", rolldownOptions: { output: stableNames } },
  plugins: [runtimeBinary(), licences(), digests()],
  test: { include: ["test/*.test.ts"] },
} as Parameters<typeof defineConfig>[0]);

import { writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { type Plugin, defineConfig } from "vite";

const here = (path: string): string => fileURLToPath(new URL(path, import.meta.url));
const MARKER = "<!--minute4d-data-->";

/** Whose it is; nothing of others is in the page. */
const LICENCE = "minute4d viewer (MIT OR Apache-2.0)";

/** One file: script and style inside, nothing to fetch, written where the Rust side includes it. */
function oneFile(output: string): Plugin {
  return {
    name: "one-file",
    enforce: "post",
    generateBundle(_options, bundle) {
      const scripts = Object.values(bundle).filter((f) => f.type === "chunk");
      const assets = Object.values(bundle).filter((f) => f.type === "asset");
      const page = assets.find((a) => a.fileName.endsWith(".html"));
      const style = assets.find((a) => a.fileName.endsWith(".css"));
      const [script] = scripts;
      if (!page || !style || !script || scripts.length !== 1 || assets.length !== 2) {
        const found = [...scripts, ...assets].map((f) => f.fileName).join(", ");
        this.error(`the page must be one script, one style and one document; there are ${found}`);
      }
      // both end or change what a script element holds; neither is in the code today
      if (/<!--|<\/script/i.test(script.code)) this.error("the script holds `<!--` or `</script`");
      const { code } = script;
      const html = String(page.source)
        .replace(/\s*<script type="module"[^>]*><\/script>/, "")
        .replace(/\s*<link rel="stylesheet"[^>]*>/, () => `\n    <style>${String(style.source)}</style>`)
        // after the charset, which must be among the first 1024 bytes
        .replace("</title>", () => `</title>\n    <!-- ${LICENCE} -->`)
        .replace("</body>", () => `<script type="module">${code}</script>\n  </body>`);
      const markers = html.split(MARKER).length - 1;
      if (markers !== 1) this.error(`the page has ${markers} places for a scene where it must have one`);
      if (/(?:src|href)="(?!#|data:)/.test(html.replace(code, ""))) this.error("the page refers to another file");
      writeFileSync(output, html);
    },
  };
}

export default defineConfig({
  plugins: [oneFile(here("../page.html"))],
  build: {
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: Number.MAX_SAFE_INTEGER,
    cssCodeSplit: false,
    emptyOutDir: true,
  },
});

import { defineConfig } from "vitest/config";

// `npm test` needs nothing but Node; `npm run test:browser` starts a Chromium on the built page
const browser = process.env["BROWSER_TESTS"] === "1";

export default defineConfig({
  test: {
    include: [browser ? "tests/browser/*.test.ts" : "tests/*.test.ts"],
    testTimeout: browser ? 90_000 : 5_000,
    hookTimeout: 60_000,
    fileParallelism: !browser,
  },
});

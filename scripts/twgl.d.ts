// For the checker: what resources/viewer/twgl.js makes has the types of its package, which 'make lint' installs.
import type * as library from "twgl.js";

declare global {
  const twgl: typeof library;
}

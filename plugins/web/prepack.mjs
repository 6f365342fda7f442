// Before `npm pack` and `npm publish`: users want the weights with the code, so there is no package
// without any.
import { readdirSync } from 'node:fs';

const found = (() => {
  try {
    return readdirSync(new URL('models/', import.meta.url));
  } catch {
    return [];
  }
})();
if (!found.some((name) => name.endsWith('.frame.onnx'))) {
  console.error('models/ must hold a frame graph: stillray-export kpyr-5s --frame-graph --out models');
  process.exit(1);
}

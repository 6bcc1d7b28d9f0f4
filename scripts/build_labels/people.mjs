// Prints the parts of the Avataaars set as SVG fragments: {part: {variant: svg}}, with words in place of colours.
// The words (COLOR_hair and so on) are replaced by build.py, once a colour. Run in the folder with node_modules.
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const folder = path.resolve('node_modules/@dicebear/avataaars/lib/components');
const parts = ['top', 'clothing', 'facialHair', 'accessories', 'mouth', 'eyes', 'eyebrows', 'nose', 'base'];
const colors = Object.fromEntries(
  ['skin', 'hair', 'hat', 'clothes', 'facialHair', 'accessories'].map((name) => [name, `COLOR_${name}`]),
);

const fragments = {};
for (const part of parts) {
  const module = await import(pathToFileURL(path.join(folder, `${part}.js`)));
  fragments[part] = Object.fromEntries(
    Object.entries(module[part]).map(([variant, draw]) => [variant, draw({}, colors)]),
  );
}
console.log(JSON.stringify(fragments));

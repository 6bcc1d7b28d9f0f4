// Prints the parts of DiceBear collections as SVG fragments: {collection: {part: {variant: svg}}}, with COLOR_name in place of
// colours, and what the collection always draws as the part "base". Arguments: collections. Run in the folder with node_modules.
import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const names = ['skin', 'hair', 'headContrast', 'clothing', 'clothes', 'facialHair', 'body', 'eyes', 'mouth', 'nose'];
const colors = Object.fromEntries(names.map((name) => [name, `COLOR_${name}`]));

const all = {};
for (const collection of process.argv.slice(2)) {
  const lib = path.resolve('node_modules/@dicebear', collection, 'lib');
  const fragments = (all[collection] = {});
  for (const file of fs.readdirSync(path.join(lib, 'components'))) {
    const part = path.basename(file, '.js');
    if (!file.endsWith('.js') || part === 'index') continue;
    const module = await import(pathToFileURL(path.join(lib, 'components', file)));
    fragments[part] = Object.fromEntries(
      Object.entries(module[part]).map(([variant, draw]) => [variant, draw({}, colors)]),
    );
  }
  const { create } = await import(pathToFileURL(path.join(lib, 'index.js')));
  const nothing = { bool: () => false, pick: () => undefined, integer: () => 0 };
  fragments.base = { default: create({ prng: nothing, options: {} }).body.replaceAll(/#?undefined|transparent/g, 'COLOR_base') };
}
console.log(JSON.stringify(all));

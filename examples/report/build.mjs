// build.mjs OUTPUT: bundles src/ into one HTML file that needs nothing else. Same input, same bytes.
import {build} from 'esbuild';
import {readFileSync, writeFileSync} from 'node:fs';
import {dirname, join} from 'node:path';
import {fileURLToPath} from 'node:url';

const folder = dirname(fileURLToPath(import.meta.url));
const output = process.argv[2] ?? join(folder, 'report.html');
const kLibraries = ['three', 'uplot'];  // the licences of what is in the page go with it
const kMark = '"@TERSE_REPORT_DATA@"';

async function bundle(entry) {
  const result = await build({
    absWorkingDir: folder, entryPoints: [entry], bundle: true, minify: true, write: false, format: 'iife',
    target: ['es2020'], charset: 'utf8', legalComments: 'none', logLevel: 'warning',
  });
  return result.outputFiles[0].text.trim();
}

function licence(name) {
  const at = join(folder, 'node_modules', name);
  const {version} = JSON.parse(readFileSync(join(at, 'package.json'), 'utf8'));
  return `${name} ${version}\n\n${readFileSync(join(at, 'LICENSE'), 'utf8').trim()}`;
}

const escape = (text) => text.replace(/&/g, '&amp;').replace(/</g, '&lt;').replace(/>/g, '&gt;');
const parts = {
  STYLE: await bundle('src/style.css'),
  SCRIPT: await bundle('src/main.js'),
  LICENCES: escape(kLibraries.map(licence).join('\n\n\n')),
};
let page = readFileSync(join(folder, 'src/page.html'), 'utf8');
for (const [name, text] of Object.entries(parts)) page = page.replace(`<!--${name}-->`, () => text);
if (page.split(kMark).length !== 2) throw new Error(`${kMark} is to occur once in the page`);
if (/<script[^>]*>[^]*<\/script[^>]*>[^]*<!--/.test(parts.SCRIPT)) throw new Error('the script would end early');
writeFileSync(output, page);
console.log(`${output}: ${(page.length / 1000).toFixed(0)} kB`);

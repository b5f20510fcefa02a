// Tests of the report page in headless Chromium.
//
//   node run.mjs REPORT.html                     checks a report that `terse report` wrote
//   node run.mjs --page report.html --sources D  the whole suite: D is a copy of examples/report with its packages installed

import {existsSync, mkdtempSync, rmSync} from 'node:fs';
import {tmpdir} from 'node:os';
import {join, resolve} from 'node:path';
import {parseArgs} from 'node:util';

import {launch, open} from './browser.mjs';
import {dataOf, fitsWidth, noProblems, numbersEqual, sliderChangesPicture} from './checks.mjs';
import {suite} from './suite.mjs';

const {values: options, positionals} = parseArgs({allowPositionals: true, options: {page: {type: 'string'}, sources: {type: 'string'}, only: {type: 'string'}}});
if (positionals.length === 0 && !(options.page && options.sources)) {
  console.error('usage: run.mjs REPORT.html | run.mjs --page examples/report/report.html --sources FOLDER');
  process.exit(2);
}

// [name, function] of the checks of one real report.
const checksOf = (path) => [
  [`${path}: on a desk`, async ({browser}) => {
    const page = await open(browser, path);
    const {runs} = await dataOf(page);
    const compared = await numbersEqual(page, runs.map(({stats}) => stats));
    await sliderChangesPicture(page);
    noProblems(page);
    await page.context().close();
    return `${compared} numbers`;
  }],
  [`${path}: on a phone, dark`, async ({browser}) => {
    const page = await open(browser, path, {width: 375, height: 812, colorScheme: 'dark'});
    await fitsWidth(page);
    noProblems(page);
    await page.context().close();
  }],
];

const scratch = mkdtempSync(join(tmpdir(), 'terse-report-'));
let failures = 0;
let browser;
try {
  const tests = positionals.length ? positionals.flatMap((path) => {
    if (!existsSync(path)) throw new Error(`${path}: the file does not exist`);
    return checksOf(resolve(path));
  }) : suite;
  browser = await launch();
  for (const [name, test] of tests) {
    if (options.only && !name.includes(options.only)) continue;
    const start = performance.now();
    try {
      const note = await test({browser, scratch, page: options.page, sources: options.sources});
      console.log(`ok    ${name}${note ? ` (${note})` : ''} ${(0.001 * (performance.now() - start)).toFixed(1)} s`);
    } catch (error) {
      failures++;
      console.log(`FAIL  ${name}\n${error.stack}`);
    }
  }
} catch (error) {
  failures++;
  console.error(`FAIL  ${error.message}`);
} finally {
  await browser?.close();
  rmSync(scratch, {recursive: true, force: true});
}
process.exit(failures ? 1 : 0);

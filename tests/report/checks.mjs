// What holds of every report: of generated data and of real ones.

import assert from 'node:assert/strict';

import {picture, slide, steps} from './browser.mjs';

const leaves = (object, prefix = '') => Object.entries(object ?? {}).flatMap(([name, value]) =>
  (value !== null && typeof value === 'object' && !Array.isArray(value) ? leaves(value, `${prefix}${name}.`) : [[prefix + name, value]]));

// The data the page was given.
export const dataOf = (page) => page.evaluate(() => JSON.parse(document.getElementById('terse-data').textContent));

// Every number of `stats` (of each run) stands in the tables with all its digits.
export async function numbersEqual(page, stats) {
  const cells = await page.evaluate(() => [...document.querySelectorAll('[data-key]')].map((cell) =>
    [cell.dataset.key, cell.dataset.value, [...cell.parentElement.querySelectorAll('[data-key]')].indexOf(cell), cell.textContent]));
  let compared = 0;
  stats.forEach((one, run) => {
    for (const [key, value] of leaves(one)) {
      const cell = cells.find((c) => c[0] === key && c[2] === run);
      assert.ok(cell, `${key} of run ${run} is not in the tables`);
      assert.deepEqual(cell[1] === undefined ? undefined : JSON.parse(cell[1]), value, `${key} of run ${run}`);
      assert.ok(cell[3].trim().length > 0, `${key} of run ${run} shows nothing`);
      compared++;
    }
  });
  return compared;
}

export async function sliderChangesPicture(page) {
  const count = await steps(page);
  if (count < 2) return;
  await slide(page, count - 1);
  const end = await picture(page);
  await slide(page, 0);
  const start = await picture(page);
  await slide(page, count - 1);
  const again = await picture(page);
  end.forEach((pane, run) => {
    assert.notEqual(pane.hash, start[run].hash, `the picture of run ${run} does not change`);
    assert.equal(pane.hash, again[run].hash, `the picture of run ${run} depends on the way to a step`);
    assert.ok(pane.ink > start[run].ink, `more is to be seen of run ${run} at the end (${pane.ink}) than at the start (${start[run].ink})`);
  });
}

// Where there is no value the page says so in words.
export async function noDashes(page) {
  const dashes = await page.evaluate(() => [...document.querySelectorAll('#main *, #player *')].filter((node) =>
    node.children.length === 0 && /^[-–—−]$/.test(node.textContent.trim())).map((node) => node.parentElement.textContent));
  assert.deepEqual(dashes, [], 'fields that show a dash');
}

export function noProblems(page) {
  assert.deepEqual(page.problems, [], 'errors in the console or requests beyond the file');
}

export async function fitsWidth(page) {
  const [content, width] = await page.evaluate(() => [document.documentElement.scrollWidth, window.innerWidth]);
  assert.ok(content <= width, `the page is ${content} pixels wide on a screen of ${width}`);
}

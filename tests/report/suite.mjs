// The suite: what the page shows of generated data.

import assert from 'node:assert/strict';
import {execFileSync} from 'node:child_process';
import {readFileSync, statSync, writeFileSync} from 'node:fs';
import {join} from 'node:path';

import {open, picture, slide, steps} from './browser.mjs';
import {fitsWidth, noDashes, noProblems, numbersEqual, sliderChangesPicture} from './checks.mjs';
import {fill, makeBareRun, makeBoundedRun, makeHolesRun, makeRetiringRun, makeRun, report} from './generate.mjs';

const kMostBytes = 900e3;  // of the page without data
const kSmall = {width: 700, height: 560};  // software GL is slow

async function withPage(test, data, options, act) {
  const path = join(test.scratch, 'report.html');
  writeFileSync(path, typeof data === 'string' ? data : fill(readFileSync(test.page, 'utf8'), data));
  const page = await open(test.browser, path, options);
  try {
    const note = await act(page);
    noProblems(page);
    return note;
  } finally {
    await page.context().close();
  }
}

const text = (page, selector) => page.locator(selector).innerText();

function rebuilt({page, sources, scratch}) {
  const made = join(scratch, 'rebuilt.html');
  execFileSync(process.execPath, [join(sources, 'build.mjs'), made]);
  assert.ok(readFileSync(made).equals(readFileSync(page)), 'the committed page is not what its sources make: run `make report-page` and commit');
  const {size} = statSync(page);
  assert.ok(size < kMostBytes, `the page has ${size} bytes`);
  return `${(size / 1000).toFixed(0)} kB`;
}

const single = (test) => withPage(test, report(makeRun({name: 'ring'})), kSmall, async (page) => {
  const run = makeRun({name: 'ring'});
  const compared = await numbersEqual(page, [run.stats]);
  await numbersEqual(page, [{thresholds: run.thresholds}]);
  await sliderChangesPicture(page);
  assert.match(await page.title(), /^ring: 40.\/.120 poses, 40 links/);
  assert.match(await text(page, '#subtitle'), /keeps 40 of 120 poses and 40 of 120 links/);
  assert.equal(await page.locator('#plots .uplot').count(), 9);
  await noDashes(page);
  return `${compared} numbers`;
});

// Where the last kept pose came in the map is complete.
const opening = (test) => withPage(test, report(makeRun({poses: 120, keepEvery: 9})), kSmall, async (page) => {
  const run = makeRun({poses: 120, keepEvery: 9});
  const last = run.poses.kept.lastIndexOf(1);
  assert.ok(last < 119, 'the run ends with dropped poses');
  assert.equal(await page.locator('#slider').inputValue(), String(last));
  assert.match(await text(page, '#decisions'), new RegExp(`pose ${run.poses.id[last]}\\s[^]*kept`));
});

// What became of a candidate that was not linked, in a replay and from images, with and without a word on whether it was tried.
const outcomes = async (test) => {
  const make = (stats) => {
    const run = makeRun();
    Object.assign(run.stats, stats);
    run.decisions.candidates[60] = [[0, 0.5, 9, null, 0, null, 1], [3, 0.5, 9, null, 0, null, 0], [6, 0.5, 1, null, 0, null, 0],
      [9, 0.5, 9, 1, 0, null, 1], [12, 0.5, 9, 8, 0, 60, 1], [15, 0.5, 9, null, 0, null, null], [18, 0.5, 9, null, 0, null, 0, 1]];
    return run;
  };
  for (const [stats, nothing] of [[{}, 'the file has no such link'], [{frames: 120}, 'registration failed']]) {
    await withPage(test, report(make(stats)), kSmall, async (page) => {
      await slide(page, 60);
      const words = await page.locator('#decisions tbody .word').allInnerTexts();
      assert.deepEqual(words.sort(), [nothing, nothing, 'not registered', 'not registered', 'too little gain', 'too little gain', 'refused'].sort());
      await noDashes(page);
    });
  }
};

// What was in range without a link in the file, whatever its gain; and a pose that came back.
const ofAReplay = async (test) => {
  const run = makeRun(), back = run.poses.kept.indexOf(0, 60);
  run.decisions.candidates[60] = [[0, 0.5, 9, null, 0, null, 0, 0], [3, 0.5, 1, null, 0, null, 0, 0], [6, 0.5, 1, null, 0, null, 0, 1], [9, 0, 9, 8, 1, 2, 1, 1]];
  await withPage(test, report(run), kSmall, async (page) => {
    await slide(page, 60);
    const words = await page.locator('#decisions tbody .word').allInnerTexts();
    const nothing = 'the file has no such link';
    assert.deepEqual(words.sort(), [nothing, nothing, 'too little gain', '✓ accepted'].sort());
  });
  const later = makeRun();
  later.poses.kept[back] = 1;
  await withPage(test, report(later), kSmall, async (page) => {
    await slide(page, back);
    assert.match(await text(page, '#decisions'), /kept\s*back for a later loop[^]*It was dropped at first/);
  });
};

// At a step the panel tells that step's decision, and the map holds what there was then.
const decisions = (test) => withPage(test, report(makeRun()), kSmall, async (page) => {
  const run = makeRun();
  const at = run.links.step[10];
  await slide(page, at);
  const panel = await text(page, '#decisions');
  assert.match(panel, new RegExp(`pose ${run.poses.id[at]}\\b`));
  assert.match(panel, /kept\s*a loop closes/);
  assert.equal(await page.locator('#decisions tbody tr').count(), run.decisions.candidates[at].length);
  assert.equal(await page.locator('#decisions tbody tr.accepted').count(), run.decisions.accepted[at]);
  assert.match(await text(page, '#layers'), new RegExp(`kept\\s+${run.steps.poses[at]}\\b[^]*links\\s+${run.steps.links[at]}\\b`));
  const shown = await page.evaluate(() => Object.fromEntries(Object.entries(window.terseReport.maps[0].layers).map(([name, {object}]) =>
    [name, object.geometry.drawRange.count / (object.isPoints ? 1 : 6)])));
  assert.equal(shown.kept, run.steps.poses[at]);
  assert.equal(shown.dropped, at + 1 - run.steps.poses[at]);
  assert.equal(shown.links, run.steps.links[at]);
  assert.equal(shown.odometry, run.steps.poses[at] - 1);
  const dropped = run.poses.kept.indexOf(0, at);
  await slide(page, dropped);
  assert.match(await text(page, '#decisions'), /dropped\s*redundant[^]*The least informative link to a kept pose would bring only[^]*not more than the threshold of 5.4 nats/);
});

// Poses found again, in words and on the map, and which edges are made of several measurements.
const bounded = (test) => withPage(test, report(makeBoundedRun()), kSmall, async (page) => {
  const run = makeBoundedRun(), id = run.poses.id, {anchored_to: to, edges} = run.decisions;
  await numbersEqual(page, [run.stats]);
  const count = to.filter((base) => base !== null).length;
  assert.match(await text(page, '#subtitle'), new RegExp(`${count} poses were found again at kept ones`));
  assert.match(await text(page, '#figures'), new RegExp(`Found again[^]*${count}`));
  const with_edge = edges.findIndex((list) => list.length > 0), without = to.findIndex((base, i) => base !== null && edges[i].length === 0);
  await slide(page, with_edge);
  const panel = await text(page, '#decisions');
  assert.match(panel, new RegExp(`not kept\\s*found again[^]*its chain starts anew at kept pose ${id[to[with_edge]]}, [^]*made 1 measurement between kept poses`));
  assert.match(panel, new RegExp(`${id[run.links.from[3]]} – ${id[run.links.to[3]]} fused with the edge[^]*0.4 nats about the map; by the end the edge is made of 7 measurements`));
  assert.deepEqual((await page.locator('#decisions tbody .word').allInnerTexts()).sort(), ['composed', 'found again', 'too little gain']);
  assert.equal(await page.locator('#decisions .badge-anchored').count(), 1);
  await slide(page, without);
  assert.match(await text(page, '#decisions'), /told the map too little for an edge/);
  await slide(page, 119);
  const shown = await page.evaluate(() => Object.fromEntries(['kept', 'dropped', 'anchored'].map((name) => [name, window.terseReport.maps[0].layers[name].object.geometry.drawRange.count])));
  assert.deepEqual(shown, {kept: 40, dropped: 80 - count, anchored: count});
  assert.match(await text(page, '#layers'), new RegExp(`found again\\s*${count}`));
  const rows = await page.locator('#edges tbody tr').allInnerTexts();
  assert.equal(rows.length, 3);
  assert.match(rows[0], /link\s+made of 7 measurements/);
  assert.match(rows[1], /odometry\s+made of 2 measurements/);
  assert.match(rows[2], /link\s+one measurement composed of links/);
  assert.match(await text(page, '[data-plot="area"]'), /poses 40[^]*area 525 m²/);
  await noDashes(page);
});

// Poses that retire: in words, in the counts, in the plot, and on the map only as long as they were kept.
const retiring = (test) => withPage(test, report(makeRetiringRun()), kSmall, async (page) => {
  const run = makeRetiringRun(), id = run.poses.id;
  await numbersEqual(page, [run.stats]);
  await sliderChangesPicture(page);
  assert.match(await text(page, '#subtitle'), /4 poses retired after a time in the map/);
  assert.match(await text(page, '#figures'), /Retired\s*4\s*poses, 0.25 nats lost/);
  assert.match(await text(page, '#tables'), /poses retired from the map\s*4[^]*information lost with retired poses, nats\s*0.25/);
  // What the graphics card is told to draw: dots below the count that are not over yet.
  const shown = () => page.evaluate(() => Object.fromEntries(['kept', 'dropped', 'anchored', 'retired'].map((name) => {
    const {object, uniforms} = window.terseReport.maps[0].layers[name];
    const until = Array.from(object.geometry.attributes.until.array).slice(0, object.geometry.drawRange.count);
    return [name, until.filter((step) => step > uniforms.now.value).length];
  })));
  const counts = async () => Object.fromEntries((await page.locator('#layers label').allInnerTexts()).map((label) => label.split(/\s+(?=\d+$)/)).filter(([, count]) => count !== undefined));
  for (const [step, kept, retired] of [[59, 20, 0], [60, 18, 3], [69, 21, 3], [70, 22, 3], [89, 28, 3], [90, 30, 2], [118, 39, 2], [119, 38, 3]]) {
    await slide(page, step);
    const dots = await shown(), words = await counts();
    assert.deepEqual([dots.kept, dots.retired], [kept, retired], `dots at step ${step}`);
    assert.equal(dots.kept + dots.retired + dots.dropped + dots.anchored, step + 1, `each pose is shown once at step ${step}`);
    assert.deepEqual([words.kept, words.retired, words.dropped], [kept, retired, dots.dropped].map(String), `counts at step ${step}`);
    assert.match(await text(page, '[data-plot="area"] .plot-readout'), new RegExp(`poses ${kept}\\b`), `plot at step ${step}`);
  }
  // Where a pose is a kept one the picture has ink that it has not any more when it retired.
  const darkAt = (pose) => page.evaluate((i) => {
    const {view, maps} = window.terseReport, {view: {renderer}} = window.terseReport;
    view.draw();
    const gl = renderer.getContext(), p = view.camera.position.clone().set(...maps[0].point(maps[0].run.position, i)).project(view.camera);
    const pixel = new Uint8Array(4);
    gl.readPixels(Math.round((0.5 + 0.5 * p.x) * gl.drawingBufferWidth), Math.round((0.5 + 0.5 * p.y) * gl.drawingBufferHeight), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return pixel[0] + pixel[1] + pixel[2] < 250;
  }, pose);
  for (const layer of ['odometry', 'links', 'truth', 'candidates', 'ellipsoids']) await page.locator(`[data-layer="${layer}"]`).uncheck();
  for (const [step, dark] of [[59, true], [60, false], [89, false], [90, true]]) {
    await slide(page, step);
    assert.equal(await darkAt(36), dark, `pose 36 on the map at step ${step}`);
  }
  await slide(page, 60);
  assert.match(await text(page, '#decisions'), new RegExp(`3 poses retired, which the map can do without: ${id[18]}, ${id[24]}, ${id[36]}\\.`));
  await slide(page, 70);
  assert.match(await text(page, '#decisions'), new RegExp(`1 pose came back into the map, because a loop led there: ${id[31]}\\.`));
  await slide(page, 24);
  assert.match(await text(page, '#decisions'), new RegExp(`pose ${id[24]}\\s*kept[^]*It retired at the step of pose ${id[60]}: `));
  await slide(page, 36);
  assert.doesNotMatch(await text(page, '#decisions'), /It retired/);
  await page.locator('#ids').fill(String(id[30]));
  await page.locator('#ids').dispatchEvent('change');
  assert.match(await text(page, '.chosen'), new RegExp(`Pose ${id[30]} · kept: [^·]*; retired at pose ${id[119]} ·[^]*a retired pose has no ellipsoid`));
  await noDashes(page);
});

// The retired ones of one of two runs.
const retiringBeside = (test) => {
  const runs = [makeRetiringRun(), makeRun({name: 'paper', seed: 2})];
  return withPage(test, report(...runs), kSmall, async (page) => {
    await numbersEqual(page, runs.map(({stats}) => stats));
    await slide(page, 119);
    assert.match(await text(page, '#layers'), /kept\s*38 \| 40[^]*retired\s*3 \| 0/);
    assert.match(await text(page, '#tables'), /poses retired from the map\s*4\s*not recorded/);
    await noDashes(page);
  });
};

const unbounded = (test) => withPage(test, report({...makeRun(), area: {cell: null, explored: []}}), kSmall, async (page) => {
  assert.equal(await page.locator('#edges, [data-layer="anchored"], [data-layer="retired"]').count(), 0);
  assert.match(await text(page, '[data-plot="area"]'), /range of the sensor is not known/);
});

const keyboard = (test) => withPage(test, report(makeRun()), kSmall, async (page) => {
  const position = () => page.evaluate(() => Number(document.getElementById('slider').value));
  const pressed = (id) => page.locator(id).getAttribute('aria-pressed');
  await page.keyboard.press('Home');
  assert.equal(await position(), 0);
  await page.keyboard.press('ArrowRight');
  assert.equal(await position(), 1);
  await page.keyboard.press('Shift+ArrowRight');
  assert.equal(await position(), 11);
  await page.keyboard.press('n');
  assert.equal(await position(), makeRun().links.step.find((step) => step > 11));
  await page.keyboard.press('Home');
  await page.keyboard.press('Space');
  await page.waitForFunction(() => Number(document.getElementById('slider').value) > 2);
  await page.keyboard.press('Space');
  const stopped = await position();
  await page.waitForTimeout(200);
  assert.equal(await position(), stopped);
  assert.equal(await pressed('#view-3d'), 'true');
  const before = (await picture(page))[0].hash;
  await page.keyboard.press('v');
  assert.equal(await pressed('#view-top'), 'true');
  assert.notEqual((await picture(page))[0].hash, before);
  await page.locator('#canvas').focus();
  const still = await position(), top = (await picture(page))[0].hash;
  await page.keyboard.press('ArrowRight');
  assert.equal(await position(), still, 'in the map the arrow keys move the map');
  assert.notEqual((await picture(page))[0].hash, top);
});

// A click on a pose chooses it, and its ellipsoid is drawn.
const choosing = (test) => withPage(test, report(makeRun()), kSmall, async (page) => {
  await page.locator('#every').fill('0');
  const without = (await picture(page))[0].hash;
  const at = await page.evaluate(() => {
    const {view, maps} = window.terseReport;
    const rect = view.canvas.getBoundingClientRect();
    view.camera.updateMatrixWorld();
    const [x, y, z] = maps[0].point(maps[0].run.position, 60);
    const p = view.camera.position.clone().set(x, y, z).project(view.camera);
    return [rect.left + (0.5 + 0.5 * p.x) * rect.width, rect.top + (0.5 - 0.5 * p.y) * rect.height];
  });
  await page.mouse.click(...at);
  assert.equal(await page.locator('#ids').inputValue(), '120');
  assert.match(await text(page, '.chosen'), /Pose 120 · kept[^]*95 % half axes/);
  const chosen = (await picture(page))[0].hash;
  assert.notEqual(chosen, without);
  await page.evaluate(() => {
    const size = document.getElementById('magnify');
    size.value = Number(size.value) + 2;
    size.dispatchEvent(new Event('input'));
  });
  assert.notEqual((await picture(page))[0].hash, chosen);
});

const comparison = (test) => {
  const runs = [makeRun({name: 'all', keepEvery: 1, links: 90, strategy: 'apal'}), makeRun({name: 'few', seed: 2})];
  return withPage(test, report(...runs), kSmall, async (page) => {
    await numbersEqual(page, runs.map(({stats}) => stats));
    await noDashes(page);
    await sliderChangesPicture(page);
    assert.equal((await picture(page)).length, 2);
    assert.equal(await page.locator('.decision').count(), 2);
    assert.match(await text(page, 'tr:has([data-key="poses_kept"]) .ratio'), /^×\s0.333$/);
    const before = await picture(page);
    await page.evaluate(() => window.terseReport.view.turn(0.4, 0.1));  // both turn
    (await picture(page)).forEach((pane, run) => assert.notEqual(pane.hash, before[run].hash));
  });
};

// Runs of different ids go by share of the run: at the end both are at their end.
const byShare = (test) => {
  const runs = [makeRun({name: 'long', poses: 200}), makeRun({name: 'short', poses: 80})];
  runs[1].poses.id = runs[1].poses.id.map((id) => id + 100000);
  return withPage(test, report(...runs), kSmall, async (page) => {
    const last = await page.evaluate(() => window.terseReport.alignment.indices.map((list) => list[list.length - 1]));
    assert.deepEqual(last, [199, 79]);
    await slide(page, 199);
    assert.match(await text(page, '.readout'), /100.%/);
    await slide(page, 100);
    assert.deepEqual(await page.evaluate(() => window.terseReport.maps.map((map) => map.step)), [100, 40]);
  });
};

const flat = (test) => withPage(test, report(makeRun({dimension: 2})), kSmall, async (page) => {
  assert.equal(await page.locator('#view-top').getAttribute('aria-pressed'), 'true');
  await sliderChangesPicture(page);
});

const cameraCoordinates = (test) => withPage(test, report(makeRun({down: 'y'})), kSmall, async (page) => {
  assert.deepEqual(await page.evaluate(() => window.terseReport.view.vertical.up), [0, -1, 0]);
  await page.keyboard.press('v');
  assert.match(await text(page, '#grid-note'), /x →\s+z ↑/);
});

const bare = (test) => withPage(test, report(makeBareRun()), kSmall, async (page) => {
  assert.match(await text(page, '#layers'), /no ground truth given: pass --ground-truth/);
  assert.match(await text(page, '[data-plot="ate"]'), /No ground truth given/);
  assert.match(await text(page, '#ellipsoids'), /No covariances/);
  assert.match(await text(page, '#decisions'), /candidates of the steps are not known/);
  await noDashes(page);
  await sliderChangesPicture(page);
});

const holes = (test) => withPage(test, report(makeHolesRun()), kSmall, async (page) => {
  await numbersEqual(page, [makeHolesRun().stats]);
  await sliderChangesPicture(page);
  for (let k = 0; k < await steps(page); k += 3) {
    await slide(page, k);
    await noDashes(page);
  }
});

const tiny = (test) => withPage(test, report(makeRun({name: 'one', poses: 1, links: 0}), makeRun({name: 'two', poses: 2, links: 0})), kSmall, async (page) => {
  await page.keyboard.press('Space');
  await picture(page);
});

const names = (test) => {
  const name = '</script><img src=x onerror=alert(1)> & "quoted" <!--';
  const run = makeRun({name, poses: 30, links: 5});
  run.stats.termination = '<b>not bold</b>';
  return withPage(test, report(run), kSmall, async (page) => {
    assert.equal(await text(page, '#title'), name);
    assert.equal(await page.locator('img, #tables b').count(), 0);
    await numbersEqual(page, [run.stats]);
  });
};

const themes = (test) => withPage(test, report(makeRun()), {...kSmall, colorScheme: 'dark'}, async (page) => {
  const brightness = async () => {
    const [{background}] = await picture(page);
    const [r, g, b] = (await page.evaluate(() => getComputedStyle(document.body).backgroundColor)).match(/\d+/g).map(Number);
    return [background & 255, (r + g + b) / 3];
  };
  for (const value of await brightness()) assert.ok(value < 60, 'dark where the system is dark');
  await page.locator('#theme').click();
  for (const value of await brightness()) assert.ok(value > 200, 'light after the button');
  await page.reload();
  for (const value of await brightness()) assert.ok(value > 200, 'remembered');
});

const phone = async (test) => {
  const long = makeRun({name: 'a_rather_long_name_of_a_run_without_any_spaces_in_it_fpfl'});
  for (const runs of [[long], [long, makeRun({name: 'few', seed: 2})]]) {
    await withPage(test, report(...runs), {width: 375, height: 812}, async (page) => {
      await fitsWidth(page);
      await sliderChangesPicture(page);
    });
  }
};

const withoutData = async (test) => {
  const page = readFileSync(test.page, 'utf8');
  await withPage(test, page, kSmall, async (opened) => assert.match(await text(opened, '#main'), /holds no data yet/));
  await withPage(test, fill(page, {format: 'terse-report-9', runs: []}), kSmall, async (opened) => assert.match(await text(opened, '#main'), /terse-report-9/));
};

// However large the run, a frame is a few draw calls, and moving the slider sends nothing but the candidates of the step.
async function large(test, count) {
  const runs = Array.from({length: count}, (_, i) => makeRun({name: `large ${i}`, poses: 10000, links: 60000, keepEvery: 2, seed: i + 1}));
  return withPage(test, report(...runs), {width: 480, height: 400}, async (page) => {
    const measured = await page.evaluate(() => {
      const {view, timeline} = window.terseReport;
      const frames = 12;
      const measure = (change) => {
        change(0);
        view.draw();
        let most = 0, draws = 0, time = 0;
        for (let i = 1; i <= frames; i++) {
          Object.assign(window.graphics, {draws: 0, bytes: 0});
          const start = performance.now();
          change(i);
          view.draw();
          time += performance.now() - start;
          most = Math.max(most, window.graphics.bytes);
          draws = Math.max(draws, window.graphics.draws);
        }
        return {bytes: most, draws, milliseconds: time / frames};
      };
      return {orbit: measure(() => view.turn(0.02, 0)), play: measure((i) => {
        timeline.playing = i > 0;
        timeline.set(5000 + 37 * i);
      })};
    });
    const {orbit, play} = measured;
    assert.equal(orbit.bytes, 0, 'turning the map sends nothing');
    assert.ok(orbit.draws <= 16 * count, `${orbit.draws} draw calls in a frame`);
    assert.ok(play.draws <= 16 * count, `${play.draws} draw calls in a frame`);
    assert.ok(play.bytes <= 15e3 * count, `${play.bytes} bytes sent in a frame`);
    return `turning ${orbit.draws} draw calls, ${orbit.milliseconds.toFixed(1)} ms; playing ${play.draws} draw calls, ${play.bytes} bytes, ${play.milliseconds.toFixed(1)} ms of script a frame`;
  });
}

export const suite = [
  ['the page is what its sources make', rebuilt], ['one run', single], ['it opens on the last kept pose', opening], ['what became of candidates', outcomes],
  ['decisions of a replay', ofAReplay],
  ['poses found again, fused edges', bounded], ['poses that retire', retiring], ['poses that retire beside a run without such', retiringBeside], ['a run without such, or range', unbounded],
  ['decisions step by step', decisions], ['keyboard', keyboard],
  ['choosing a pose', choosing], ['two runs', comparison], ['two runs by share', byShare], ['2D starts from above', flat],
  ['camera coordinates', cameraCoordinates], ['without truth, covariances, steps', bare], ['holes in the data', holes], ['one pose and two', tiny],
  ['names with HTML in them', names], ['light and dark', themes], ['a phone', phone], ['without data', withoutData],
  ['10 000 poses, 60 000 links', (test) => large(test, 1)], ['twice that side by side', (test) => large(test, 2)],
];

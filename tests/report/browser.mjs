// Headless Chromium with software WebGL, and what the tests ask a page.

import {accessSync, constants} from 'node:fs';
import {delimiter, join} from 'node:path';
import {pathToFileURL} from 'node:url';
import {chromium} from 'playwright-core';

const kNames = ['chromium', 'chromium-browser', 'google-chrome'];

export function findBrowser() {
  for (const name of kNames) {
    for (const folder of (process.env.PATH ?? '').split(delimiter)) {
      const path = join(folder, name);
      try {
        accessSync(path, constants.X_OK);
        return path;
      } catch { /* not here */ }
    }
  }
  throw new Error(`no browser: none of ${kNames.join(', ')} is on PATH. Install the package chromium.`);
}

// Only WebGL has to go through the software graphics card; it is slow at all else.
export const launch = () => chromium.launch({
  executablePath: findBrowser(), args: ['--no-sandbox', '--enable-unsafe-swiftshader', '--use-angle=swiftshader', '--ignore-gpu-blocklist',
    '--disable-gpu-rasterization', '--disable-accelerated-2d-canvas', '--disable-dev-shm-usage'],
});

// Runs in the page before its own scripts: counts what is sent to the graphics card and what is drawn.
function countGraphics() {
  window.graphics = {draws: 0, bytes: 0};
  const methods = WebGL2RenderingContext.prototype;
  const wrap = (name, count) => {
    const original = methods[name];
    methods[name] = function (...parameters) {
      count(parameters);
      return original.apply(this, parameters);
    };
  };
  for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced']) wrap(name, () => { window.graphics.draws++; });
  wrap('bufferData', ([, data]) => { window.graphics.bytes += typeof data === 'number' ? data : data?.byteLength ?? 0; });
  // bufferSubData(target, offset, data, first, count): count elements of data, or all
  wrap('bufferSubData', ([, , data, , count]) => { window.graphics.bytes += count ? count * (data.BYTES_PER_ELEMENT ?? 1) : data.byteLength; });
  for (const name of ['texImage2D', 'texSubImage2D']) wrap(name, (parameters) => { window.graphics.bytes += parameters[parameters.length - 1]?.byteLength ?? 0; });
}

// A page showing a file; `page.problems` collects errors of the console and requests beyond the file itself.
export async function open(browser, path, {width = 1280, height = 800, colorScheme = 'light'} = {}) {
  const context = await browser.newContext({viewport: {width, height}, colorScheme, reducedMotion: 'reduce'});
  const page = await context.newPage();
  const url = pathToFileURL(path).href;
  page.problems = [];
  page.on('console', (message) => {
    // What Chromium says about reading pixels back with software GL is not about the page.
    if (['error', 'warning'].includes(message.type()) && !/GPU stall|swiftshader|Automatic fallback/i.test(message.text())) page.problems.push(message.text());
  });
  page.on('pageerror', (error) => page.problems.push(error.stack ?? String(error)));
  page.on('request', (request) => {
    if (request.url() !== url && !request.url().startsWith('data:')) page.problems.push(`request of ${request.url()}`);
  });
  await page.addInitScript(countGraphics);
  await page.goto(url);
  return page;
}

// Of each run's part of the canvas: how many pixels are not of the background, and a hash of all.
export const picture = (page) => page.evaluate(() => {
  const {view} = window.terseReport;
  view.draw();
  const gl = view.renderer.getContext(), ratio = view.renderer.getPixelRatio();
  const height = gl.drawingBufferHeight;
  return view.panes().map((pane) => {
    const [w, h] = [Math.floor(pane.width * ratio), Math.floor(pane.height * ratio)];
    const pixels = new Uint8Array(4 * w * h);
    gl.readPixels(Math.round(pane.x * ratio), height - Math.round(pane.y * ratio) - h, w, h, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const words = new Uint32Array(pixels.buffer);
    const counts = new Map();
    let hash = 2166136261;
    for (const word of words) {
      counts.set(word, (counts.get(word) ?? 0) + 1);
      hash = Math.imul(hash ^ word, 16777619) >>> 0;
    }
    return {ink: words.length - Math.max(...counts.values()), hash, background: [...counts].sort((a, b) => b[1] - a[1])[0][0]};
  });
});

export const slide = (page, position) => page.evaluate((k) => {
  const slider = document.getElementById('slider');
  slider.value = k;
  slider.dispatchEvent(new Event('input', {bubbles: true}));
}, position);

export const steps = (page) => page.evaluate(() => Number(document.getElementById('slider').max) + 1);

// Canvas, cameras and input: one canvas for all runs, each in its part of it, all seen by the same camera. Draws on demand.

import {Matrix4, MOUSE, OrthographicCamera, PerspectiveCamera, Scene, TOUCH, Vector3, Vector4, WebGLRenderer} from 'three';
import {OrbitControls} from 'three/examples/jsm/controls/OrbitControls.js';

import {ramp, rgbVariable} from './colour.js';
import {segments, shared} from './layers.js';

const kFieldOfView = 38;  // degrees, vertical
const kElevation = 0.65, kAzimuth = 0.4;  // radians, of the first view; from the longer side

// A length of 1, 2 or 5 times a power of ten, not above x.
export function niceLength(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * ([5, 2, 1].find((k) => k * power <= x * 1.0001) ?? 1);
}

export class View {
  // `maps`: MapScene of each run; `box` around them, less the centre; `vertical` as of verticalAxis.
  constructor(canvas, maps, box, vertical, onPick, onHover) {
    Object.assign(this, {canvas, maps, box, vertical, onPick, onHover});
    // Dots and segments have soft edges of their own; the rest gets them where there is little to draw.
    const little = maps.reduce((sum, {run}) => sum + run.n + run.links.from.length, 0) < 8000;
    this.renderer = new WebGLRenderer({canvas, antialias: little, powerPreference: 'high-performance'});
    this.renderer.setScissorTest(true);
    this.renderer.autoClear = false;
    this.renderer.info.autoReset = false;
    this.renderer.debug.checkShaderErrors = false;  // would wait for the graphics card
    this.frames = 0;
    this.radius = Math.max(0.5 * Math.hypot(...box.max.map((x, k) => x - box.min[k])), 1e-3);
    this.up = new Vector3(...vertical.up);
    this.north = new Vector3(...vertical.north);
    this.grid = this.makeGrid();
    this.cameras = {'3d': new PerspectiveCamera(kFieldOfView, 1, 0.01, 100), top: new OrthographicCamera()};
    this.cameras['3d'].up.copy(this.up);
    this.cameras.top.up.copy(this.north);
    this.controls = {};
    for (const [name, camera] of Object.entries(this.cameras)) {
      const controls = new OrbitControls(camera, canvas);
      controls.enabled = false;
      controls.zoomToCursor = this.maps.length === 1;
      controls.addEventListener('change', () => this.request());
      this.controls[name] = controls;
    }
    this.controls.top.enableRotate = false;
    this.controls.top.mouseButtons.LEFT = MOUSE.PAN;
    this.controls.top.touches = {ONE: TOUCH.PAN, TWO: TOUCH.DOLLY_PAN};
    this.mode = '3d';
    this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
    this.setMode('3d');
    this.fit();
  }

  get camera() { return this.cameras[this.mode]; }

  // Parallel lines a nice length apart, on the lowest level of the map.
  makeGrid() {
    const {axis, up} = this.vertical;
    const [u, v] = [0, 1, 2].filter((k) => k !== axis);
    const extent = Math.max(this.box.max[u] - this.box.min[u], this.box.max[v] - this.box.min[v], 1e-3);
    this.gridStep = niceLength(extent / 5);
    const level = up[axis] > 0 ? this.box.min[axis] : this.box.max[axis];
    const list = [];
    for (const [along, other] of [[u, v], [v, u]]) {
      const low = Math.floor(this.box.min[along] / this.gridStep - 0.5), high = Math.ceil(this.box.max[along] / this.gridStep + 0.5);
      const from = (Math.floor(this.box.min[other] / this.gridStep - 0.5)) * this.gridStep;
      const to = (Math.ceil(this.box.max[other] / this.gridStep + 0.5)) * this.gridStep;
      for (let k = low; k <= high; k++) {
        const a = [0, 0, 0], b = [0, 0, 0];
        a[along] = b[along] = k * this.gridStep;
        [a[other], b[other]] = [from, to];
        a[axis] = b[axis] = level;
        list.push([a, b, -1]);
      }
    }
    const grid = segments(list, {width: 1, lift: -8, order: -1});
    grid.show(list.length);
    this.gridScene = new Scene();
    this.gridScene.add(grid.object);
    return grid;
  }

  // {x, y, width, height} of each run in CSS pixels, from the top left.
  panes() {
    const {clientWidth: width, clientHeight: height} = this.canvas.parentElement;
    const count = this.maps.length;
    const columns = width < 620 ? 1 : Math.ceil(Math.sqrt(count));
    const rows = Math.ceil(count / columns);
    return this.maps.map((_, i) => ({
      x: ((i % columns) * width) / columns, y: (Math.floor(i / columns) * height) / rows, width: width / columns, height: height / rows,
    }));
  }

  resize() {
    const {clientWidth: width, clientHeight: height} = this.canvas.parentElement;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    this.setAspect();
    this.onLayout?.(this.panes());
    this.request();
  }

  setAspect() {
    const {width, height} = this.panes()[0];
    this.cameras['3d'].aspect = width / height;
    const half = this.topHalfHeight ?? 1;
    Object.assign(this.cameras.top, {top: half, bottom: -half, left: (-half * width) / height, right: (half * width) / height});
    for (const camera of Object.values(this.cameras)) camera.updateProjectionMatrix();
  }

  setMode(mode) {
    this.mode = mode;
    for (const [name, controls] of Object.entries(this.controls)) controls.enabled = name === mode;
    this.request();
  }

  // The whole map in the picture, from the first direction, clear of the labels above and the legend below it.
  fit() {
    const points = this.maps.flatMap((map) => map.sample()).map((p) => new Vector3(...p));
    const {width, height} = this.panes()[0];
    const inset = {top: this.maps.length > 1 ? 34 : 16, bottom: 62, side: 18};
    const share = {x: 1 - (2 * inset.side) / width, y: 1 - (inset.top + inset.bottom) / height, up: (inset.bottom - inset.top) / height};
    this.fitPerspective(points, width / height, share);
    this.fitTop(points, width / height, share);
    this.setAspect();
    for (const controls of Object.values(this.controls)) controls.update();
    this.request();
  }

  fitPerspective(points, aspect, share) {
    const east = new Vector3().crossVectors(this.north, this.up);
    const size = (axis) => Math.abs(axis.dot(new Vector3(...this.box.max)) - axis.dot(new Vector3(...this.box.min)));
    const azimuth = size(east) >= size(this.north) ? kAzimuth : 0.5 * Math.PI - kAzimuth;
    const flat = this.north.clone().multiplyScalar(-Math.cos(azimuth)).addScaledVector(east, Math.sin(azimuth));
    const direction = flat.multiplyScalar(Math.cos(kElevation)).addScaledVector(this.up, Math.sin(kElevation)).normalize();
    const right = new Vector3().crossVectors(this.up, direction).normalize();
    const above = new Vector3().crossVectors(direction, right);
    const tangent = Math.tan((kFieldOfView * Math.PI) / 360);
    const target = new Vector3();
    let distance = 0.1 * this.radius;
    for (let pass = 0; pass < 6; pass++) {  // as far as needed, then the middle of what is seen to the middle of the picture
      distance = points.reduce((most, p) => {
        const at = p.clone().sub(target);
        return Math.max(most, at.dot(direction) + Math.max(Math.abs(at.dot(above)) / (tangent * share.y), Math.abs(at.dot(right)) / (tangent * aspect * share.x)));
      }, 0.1 * this.radius);
      for (const axis of [right, above]) {
        const seen = points.map((p) => p.clone().sub(target)).map((at) => at.dot(axis) / (distance - at.dot(direction)));
        if (seen.length) target.addScaledVector(axis, 0.5 * distance * (Math.max(...seen) + Math.min(...seen)));
      }
    }
    target.addScaledVector(above, -share.up * distance * tangent);
    const camera = this.cameras['3d'], controls = this.controls['3d'];
    controls.target.copy(target);
    controls.minDistance = 0.005 * this.radius;
    controls.maxDistance = 20 * this.radius;
    camera.position.copy(target).addScaledVector(direction, distance);
    Object.assign(camera, {near: distance / 500, far: distance + 60 * this.radius});
  }

  fitTop(points, aspect, share) {
    const right = new Vector3().crossVectors(this.up.clone().negate(), this.north);
    const half = (axis) => points.reduce((most, p) => Math.max(most, Math.abs(p.dot(axis))), 1e-3);
    this.topHalfHeight = Math.max(half(this.north) / share.y, half(right) / (aspect * share.x));
    const {target} = this.controls.top;
    target.copy(this.north).multiplyScalar(-share.up * this.topHalfHeight);
    const top = this.cameras.top;
    top.zoom = 1;
    top.position.copy(target).addScaledVector(this.up, 4 * this.radius);
    Object.assign(top, {near: 0, far: 8 * this.radius});
  }

  zoom(factor) {
    if (this.mode === 'top') {
      this.camera.zoom *= factor;
      this.camera.updateProjectionMatrix();
    } else {
      const {target} = this.controls['3d'];
      this.camera.position.sub(target).multiplyScalar(1 / factor).add(target);
    }
    this.controls[this.mode].update();
    this.request();
  }

  // Turns by angles in radians; from above the map is moved instead.
  turn(azimuth, elevation) {
    const {target} = this.controls[this.mode];
    if (this.mode === 'top') {
      const right = new Vector3().crossVectors(this.up.clone().negate(), this.north);
      const size = this.topHalfHeight / this.camera.zoom;
      const by = right.multiplyScalar(-azimuth * size).addScaledVector(this.north, elevation * size);
      target.add(by);
      this.camera.position.add(by);
    } else {
      const offset = this.camera.position.clone().sub(target).applyAxisAngle(this.up, azimuth);
      const right = new Vector3().crossVectors(this.up, offset).normalize();
      const now = Math.asin(offset.dot(this.up) / offset.length());
      offset.applyAxisAngle(right, -(Math.min(Math.max(now + elevation, -1.5), 1.5) - now));
      this.camera.position.copy(target).add(offset);
    }
    this.controls[this.mode].update();
    this.request();
  }

  listen() {
    const {canvas} = this;
    let down = null;
    canvas.addEventListener('pointerdown', (event) => { down = [event.clientX, event.clientY]; });
    canvas.addEventListener('pointerup', (event) => {
      const moved = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]);
      if (down && moved < 4) this.onPick(this.pick(event, event.pointerType === 'mouse' ? 10 : 22), event.shiftKey || event.ctrlKey || event.metaKey);
      down = null;
    });
    canvas.addEventListener('pointermove', (event) => {
      if (event.pointerType === 'mouse' && event.buttons === 0) this.onHover(this.pick(event, 8), event);
      else this.onHover(null);
    });
    canvas.addEventListener('pointerleave', () => this.onHover(null));
    const keys = {
      ArrowLeft: () => this.turn(-0.12, 0), ArrowRight: () => this.turn(0.12, 0), ArrowUp: () => this.turn(0, 0.08),
      ArrowDown: () => this.turn(0, -0.08), '+': () => this.zoom(1.2), '=': () => this.zoom(1.2), '-': () => this.zoom(1 / 1.2), 0: () => this.fit(),
    };
    canvas.addEventListener('keydown', (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      keys[event.key]();
      event.preventDefault();
      event.stopPropagation();
    });
    canvas.addEventListener('webglcontextrestored', () => this.request());
  }

  // {run, pose} at a mouse event, or null.
  pick(event, reach) {
    const rect = this.canvas.getBoundingClientRect();
    const x = event.clientX - rect.left, y = event.clientY - rect.top;
    const panes = this.panes();
    const run = panes.findIndex((p) => x >= p.x && x < p.x + p.width && y >= p.y && y < p.y + p.height);
    if (run < 0) return null;
    const pane = panes[run];
    this.camera.updateMatrixWorld();
    const matrix = new Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    const point = new Vector4();
    const project = ([px, py, pz]) => {
      point.set(px, py, pz, 1).applyMatrix4(matrix);
      if (point.w <= 0) return null;
      return [pane.x + (0.5 + (0.5 * point.x) / point.w) * pane.width, pane.y + (0.5 - (0.5 * point.y) / point.w) * pane.height];
    };
    const pose = this.maps[run].pick(project, x, y, reach);
    return pose == null ? null : {run, pose};
  }

  setTheme(theme) {
    shared.gains.value = ramp(theme).flat();
    this.background = rgbVariable('--stage');
    this.grid.uniforms.colour.value.set(...rgbVariable('--grid'));
    for (const map of this.maps) map.setTheme();
    this.request();
  }

  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.draw();
    });
  }

  draw() {
    const height = this.canvas.parentElement.clientHeight;
    if (height === 0 || !this.background) return;
    const {renderer, camera} = this;
    renderer.info.reset();
    shared.pixelRatio.value = renderer.getPixelRatio();
    const [r, g, b] = this.background;
    const gl = renderer.getContext();
    this.panes().forEach((pane, i) => {
      const y = height - pane.y - pane.height;
      renderer.setViewport(pane.x, y, pane.width, pane.height);
      renderer.setScissor(pane.x, y, pane.width, pane.height);
      shared.viewport.value.set(pane.width, pane.height);
      shared.dotScale.value = Math.min(Math.max(Math.sqrt(pane.width / 700), 0.65), 1);
      renderer.state.buffers.depth.setMask(true);
      // Not by three, which would take the colour as linear: what the shaders write is sRGB already.
      gl.clearColor(r, g, b, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      renderer.render(this.gridScene, camera);
      renderer.render(this.maps[i].scene, camera);
    });
    this.frames++;
  }
}

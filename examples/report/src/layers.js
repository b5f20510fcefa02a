// What the map is drawn with: dots, segments and ellipsoids. Each is one draw call however many there are; showing fewer
// steps only changes a count, nothing is sent again. Sizes are in CSS pixels.

import {BufferAttribute, BufferGeometry, DoubleSide, DynamicDrawUsage, InstancedBufferAttribute, InstancedBufferGeometry,
  LineSegments, Mesh, Points, ShaderMaterial, Sphere, Vector2, Vector3} from 'three';

import {kRampSize} from './colour.js';

// Shared by all materials: {value} objects that the view sets when it draws.
export const shared = {viewport: {value: new Vector2(1, 1)}, pixelRatio: {value: 1}, dotScale: {value: 1}, gains: {value: []}};

export const colourUniform = () => ({value: new Vector3()});

function material(vertexShader, fragmentShader, uniforms, options = {}) {
  return new ShaderMaterial({vertexShader, fragmentShader, uniforms: {...shared, ...uniforms}, transparent: true, ...options});
}

function prepare(object, order) {
  object.frustumCulled = false;
  object.renderOrder = order;
  object.geometry.boundingSphere = new Sphere(new Vector3(), Infinity);
  return object;
}

// Nearer to the eye than it is, so that dots are not cut by the lines that end in them.
const kLift = 'gl_Position.z -= lift * 1e-4 * gl_Position.w;';

// A dot is outside the picture from the step `until` on.
const kDotVertex = `
attribute float until;
uniform float size, pixelRatio, dotScale, lift, now;
void main() {
  if (until <= now) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); gl_PointSize = 1.0; return; }
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  ${kLift}
  gl_PointSize = size * dotScale * pixelRatio;
}`;

// A disc with an edge one pixel soft; hollow if `stroke` (pixels) is positive.
const kDotFragment = `
uniform vec3 colour;
uniform float size, stroke, pixelRatio, dotScale, opacity;
void main() {
  float whole = size * dotScale * pixelRatio;
  float r = length(gl_PointCoord - 0.5) * whole, outer = 0.5 * whole;
  float alpha = clamp(outer - r, 0.0, 1.0);
  if (stroke > 0.0) alpha *= clamp(r - outer + stroke * pixelRatio + 0.5, 0.0, 1.0);
  if (alpha <= 0.02) discard;
  gl_FragColor = vec4(colour, alpha * opacity);
}`;

// `positions`: x, y, z of each dot, in the order in which they appear; `until`: the value of the uniform `now` from which on
// a dot is there no more, if not for ever.
export function dots(positions, {size, stroke = 0, lift = 1, opacity = 1, order = 0, until = []}) {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(new Float32Array(positions), 3));
  const ends = Float32Array.from({length: positions.length / 3}, (_, i) => Math.min(until[i] ?? Infinity, 1e30));
  geometry.setAttribute('until', new BufferAttribute(ends, 1));
  geometry.setDrawRange(0, 0);
  const uniforms = {size: {value: size}, stroke: {value: stroke}, lift: {value: lift}, opacity: {value: opacity}, colour: colourUniform(), now: {value: 0}};
  const object = prepare(new Points(geometry, material(kDotVertex, kDotFragment, uniforms, {depthWrite: opacity === 1})), order);
  return {object, uniforms, show: (count) => geometry.setDrawRange(0, count)};
}

// One dot that moves.
export function marker(options) {
  const layer = dots([0, 0, 0], options);
  return {...layer, move(point) {
    layer.object.visible = !!point;
    if (point) layer.object.position.set(...point);
    layer.show(point ? 1 : 0);
  }};
}

// A segment is a rectangle of constant width on the screen, four vertices that all know both ends. (Instances of four
// vertices each would be less to send, but slow to draw.) What lies behind the eye is cut off first.
const kSegmentVertex = `
attribute vec3 end;
attribute float value;
uniform vec2 viewport;
uniform float width, pixelRatio, lift;
varying float level, along, across;
void main() {
  vec4 a = modelViewMatrix * vec4(position, 1.0), b = modelViewMatrix * vec4(end, 1.0);
  if (projectionMatrix[2][3] < -0.5) {
    float near = -1.0001 * projectionMatrix[3][2] / (projectionMatrix[2][2] - 1.0);
    if (a.z > near && b.z > near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
    if (a.z > near) a = mix(a, b, (near - a.z) / (b.z - a.z));
    else if (b.z > near) b = mix(b, a, (near - b.z) / (a.z - b.z));
  }
  vec4 p = projectionMatrix * a, q = projectionMatrix * b;
  vec2 scale = 0.5 * viewport * pixelRatio;
  vec2 direction = (q.xy / q.w - p.xy / p.w) * scale;
  float size = length(direction);
  direction = size > 1e-6 ? direction / size : vec2(1.0, 0.0);
  float side = (gl_VertexID & 1) == 0 ? -1.0 : 1.0, share = (gl_VertexID & 2) == 0 ? 0.0 : 1.0;
  gl_Position = share < 0.5 ? p : q;
  float half_width = 0.5 * (width * pixelRatio + 1.0);
  gl_Position.xy += vec2(-direction.y, direction.x) * side * half_width / scale * gl_Position.w;
  ${kLift}
  across = side * half_width;
  along = share * size / pixelRatio;
  level = value;
}`;

// level < 0: the plain colour; else a place on the scale, 0 .. 1.
const kLevelColour = `
uniform vec3 colour;
uniform vec3 scale_colours[${kRampSize}];
vec3 level_colour(float level) {
  if (level < 0.0) return colour;
  float x = min(level, 0.9999) * ${(kRampSize - 1).toFixed(1)};
  int i = int(x);
  return mix(scale_colours[i], scale_colours[i + 1], x - float(i));
}`;

// Dashed where the value is below `dash_below`.
const kSegmentFragment = `${kLevelColour}
uniform float width, pixelRatio, opacity, dash_below;
varying float level, along, across;
void main() {
  if (level < dash_below && mod(along, 7.0) > 4.0) discard;
  float alpha = clamp(0.5 * (width * pixelRatio + 1.0) - abs(across), 0.0, 1.0) * opacity;
  if (alpha <= 0.02) discard;
  gl_FragColor = vec4(level_colour(level), alpha);
}`;

function segmentGeometry(capacity, usage) {
  const geometry = new BufferGeometry();
  for (const [name, size] of [['position', 3], ['end', 3], ['value', 1]]) {
    const attribute = new BufferAttribute(new Float32Array(4 * Math.max(capacity, 1) * size), size);
    if (usage) attribute.setUsage(usage);
    geometry.setAttribute(name, attribute);
  }
  const index = new Uint32Array(6 * capacity);
  for (let i = 0; i < capacity; i++) [0, 1, 2, 2, 1, 3].forEach((corner, k) => { index[6 * i + k] = 4 * i + corner; });
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.setDrawRange(0, 0);
  return geometry;
}

// `list`: [start, end, value] each, in the order in which they appear; start, end: [x, y, z].
export function segments(list, {width, lift = 0, opacity = 1, order = 0, dashBelow = -9, scale, capacity = 0}) {
  const geometry = segmentGeometry(Math.max(list.length, capacity), capacity ? DynamicDrawUsage : null);
  const {position, end, value} = geometry.attributes;
  const write = (items) => items.forEach(([a, b, v], i) => {
    for (let k = 4 * i; k < 4 * i + 4; k++) {
      position.array.set(a, 3 * k);
      end.array.set(b, 3 * k);
      value.array[k] = v;
    }
  });
  write(list);
  const uniforms = {width: {value: width}, lift: {value: lift}, opacity: {value: opacity}, dash_below: {value: dashBelow},
    colour: colourUniform(), scale_colours: scale ?? shared.gains};
  const object = prepare(new Mesh(geometry, material(kSegmentVertex, kSegmentFragment, uniforms,
    {side: DoubleSide, depthWrite: false})), order);
  object.visible = false;
  const show = (count) => {
    geometry.setDrawRange(0, 6 * count);
    object.visible = count > 0;
  };
  // Only what changed is sent.
  const replace = (items) => {
    write(items);
    for (const attribute of [position, end, value]) {
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, 4 * items.length * attribute.itemSize);
      attribute.needsUpdate = items.length > 0;
    }
    show(items.length);
  };
  return {object, uniforms, show, replace};
}

const kHairVertex = `
attribute float value;
uniform float lift;
varying float level;
void main() {
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  ${kLift}
  level = value;
}`;

const kHairFragment = `${kLevelColour}
uniform float opacity;
varying float level;
void main() { gl_FragColor = vec4(level_colour(level), opacity); }`;

// As `segments`, for many: one pixel of the screen wide, and much less to draw.
export function hairlines(list, {lift = 0, opacity = 1, order = 0}) {
  const geometry = new BufferGeometry();
  const position = new Float32Array(6 * list.length), value = new Float32Array(2 * list.length);
  list.forEach(([a, b, v], i) => {
    position.set(a, 6 * i);
    position.set(b, 6 * i + 3);
    value.fill(v, 2 * i, 2 * i + 2);
  });
  geometry.setAttribute('position', new BufferAttribute(position, 3));
  geometry.setAttribute('value', new BufferAttribute(value, 1));
  const uniforms = {lift: {value: lift}, opacity: {value: opacity}, colour: colourUniform(), scale_colours: shared.gains};
  const object = prepare(new LineSegments(geometry, material(kHairVertex, kHairFragment, uniforms, {depthWrite: false})), order);
  const show = (count) => {
    geometry.setDrawRange(0, 2 * count);
    object.visible = count > 0;
  };
  show(0);
  return {object, uniforms, show};
}

// Unit sphere as triangles, and three of its great circles as lines; deformed per instance by a centre and three half axes.
const kEllipsoidVertex = `
attribute vec3 centre, axis_x, axis_y, axis_z;
uniform float scale;
varying vec3 normal_view, to_eye;
vec3 across(vec3 axis, float share) { return axis * share / max(dot(axis, axis), 1e-12); }
void main() {
  vec3 offset = axis_x * position.x + axis_y * position.y + axis_z * position.z;
  vec4 view = modelViewMatrix * vec4(centre + scale * offset, 1.0);
  gl_Position = projectionMatrix * view;
  vec3 n = across(axis_x, position.x) + across(axis_y, position.y) + across(axis_z, position.z);
  normal_view = mat3(modelViewMatrix) * n;
  to_eye = projectionMatrix[2][3] < -0.5 ? -view.xyz : vec3(0.0, 0.0, 1.0);
}`;

const kFillFragment = `
uniform vec3 colour;
varying vec3 normal_view, to_eye;
void main() {
  float facing = abs(dot(normalize(normal_view), normalize(to_eye)));
  gl_FragColor = vec4(colour, mix(0.42, 0.12, facing));
}`;

const kLineFragment = `
uniform vec3 colour;
void main() { gl_FragColor = vec4(colour, 0.75); }`;

function sphere() {
  const rows = 12, columns = 24, positions = [], index = [];
  for (let r = 0; r <= rows; r++) {
    for (let c = 0; c <= columns; c++) {
      const v = (Math.PI * r) / rows, u = (2 * Math.PI * c) / columns;
      positions.push(Math.sin(v) * Math.cos(u), Math.sin(v) * Math.sin(u), Math.cos(v));
      if (r === rows || c === columns) continue;
      const k = r * (columns + 1) + c;
      index.push(k, k + columns + 1, k + 1, k + 1, k + columns + 1, k + columns + 2);
    }
  }
  return {positions, index};
}

function circles() {
  const parts = 48, positions = [];
  for (let plane = 0; plane < 3; plane++) {
    for (let i = 0; i < parts; i++) {
      for (const k of [i, i + 1]) {
        const point = [0, 0, 0];
        point[plane] = Math.cos((2 * Math.PI * k) / parts);
        point[(plane + 1) % 3] = Math.sin((2 * Math.PI * k) / parts);
        positions.push(...point);
      }
    }
  }
  return {positions};
}

// `list`: [centre, half axis, half axis, half axis], each [x, y, z].
export function ellipsoids(list, {order = 0, colour}) {
  const uniforms = {scale: {value: 1}, colour};
  const columns = ['centre', 'axis_x', 'axis_y', 'axis_z'].map((name, column) =>
    [name, new InstancedBufferAttribute(new Float32Array(list.flatMap((item) => item[column])), 3)]);
  const shape = ({positions, index}) => {
    const geometry = new InstancedBufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(new Float32Array(positions), 3));
    if (index) geometry.setIndex(index);
    for (const [name, attribute] of columns) geometry.setAttribute(name, attribute);
    geometry.instanceCount = 0;
    return geometry;
  };
  const fill = prepare(new Mesh(shape(sphere()), material(kEllipsoidVertex, kFillFragment, uniforms,
    {depthWrite: false})), order);
  const lines = prepare(new LineSegments(shape(circles()), material(kEllipsoidVertex, kLineFragment, uniforms,
    {depthWrite: false})), order);
  const objects = [fill, lines];
  return {
    objects, uniforms,
    show(count) {
      for (const object of objects) {
        object.geometry.instanceCount = count;
        object.visible = count > 0;
      }
    },
    dispose() {
      for (const object of objects) {
        object.removeFromParent();
        object.geometry.dispose();
        object.material.dispose();
      }
    },
  };
}

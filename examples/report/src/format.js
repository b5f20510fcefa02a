// Numbers and small pieces of HTML for people.

const kThin = '\u202f';

export const group = (text) => text.replace(/\B(?=(\d{3})+$)/g, kThin);

const kUnknown = 'unknown';  // what a field without a value shows, unless its place has a better word

export function integer(x) {
  return Number.isFinite(x) ? (x < 0 ? '−' : '') + group(String(Math.abs(Math.round(x)))) : kUnknown;
}

// About `digits` significant digits, without exponents where that stays short.
export function number(x, digits = 4) {
  if (typeof x !== 'number' || !Number.isFinite(x)) return kUnknown;
  if (x === 0) return '0';
  const size = Math.abs(x), sign = x < 0 ? '−' : '';
  if (Number.isInteger(x) && size < 1e9) return integer(x);
  if (size >= 1e7 || size < 1e-4) {
    const [mantissa, exponent] = size.toExponential(Math.min(digits, 3) - 1).split('e');
    return `${sign}${Number(mantissa)}·10${superscript(Number(exponent))}`;
  }
  const [whole, part] = String(Number(size.toPrecision(Math.max(digits, Math.floor(Math.log10(size)) + 1)))).split('.');
  return sign + group(whole) + (part ? `.${part}` : '');
}

const superscript = (n) => String(n).replace(/[-\d]/g, (c) => (c === '-' ? '⁻' : '⁰¹²³⁴⁵⁶⁷⁸⁹'[c]));

export function seconds(x) {
  if (!Number.isFinite(x)) return kUnknown;
  if (x === 0) return '0 s';
  const size = Math.abs(x);
  if (size < 1e-3) return `${number(x * 1e6, 3)} µs`;
  if (size < 1) return `${number(x * 1e3, 3)} ms`;
  return `${number(x, 4)} s`;
}

export const percent = (part, whole) => (whole > 0 ? `${number((100 * part) / whole, 3)}${kThin}%` : kUnknown);

export const plural = (count, one, many = `${one}s`) => `${integer(count)} ${count === 1 ? one : many}`;

// element('td', {class: 'x', 'data-key': k}, child, 'text'): text is text, never HTML.
export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
    else if (value === true) node.setAttribute(name, '');
    else if (value !== false && value != null) node.setAttribute(name, value);
  }
  node.append(...children.flat().filter((child) => child != null && child !== false));
  return node;
}

// Icons of 24 x 24, drawn by the given path.
export function icon(path) {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  svg.setAttribute('viewBox', '0 0 24 24');
  svg.setAttribute('aria-hidden', 'true');
  const shape = document.createElementNS('http://www.w3.org/2000/svg', 'path');
  shape.setAttribute('d', path);
  svg.append(shape);
  return svg;
}

export const kIcons = {
  play: 'M7 4.5v15l12-7.5z', pause: 'M7 5h3.5v14H7zM13.5 5H17v14h-3.5z',
  back: 'M15 5v14L6 12zM17 5h2v14h-2z', forward: 'M9 5v14l9-7zM5 5h2v14H5z',
  first: 'M18 5v14l-9-7zM6 5h2.2v14H6z', last: 'M6 5v14l9-7zM15.8 5H18v14h-2.2z',
  linkBack: 'M13 6l-6 6 6 6 1.6-1.6L10.2 12l4.4-4.4zM17.5 9.5a2.5 2.5 0 100 5 2.5 2.5 0 000-5z',
  linkForward: 'M11 6l6 6-6 6-1.6-1.6 4.4-4.4-4.4-4.4zM6.5 9.5a2.5 2.5 0 110 5 2.5 2.5 0 010-5z',
  left: 'M12 5V1.5L6.5 6.5 12 11.5V7.6a5.4 5.4 0 11-5.3 6.6H4.1A8 8 0 1012 5z',
  right: 'M12 5V1.5l5.5 5-5.5 5V7.6a5.4 5.4 0 105.3 6.6h2.6A8 8 0 1112 5z',
  in: 'M11 5h2v6h6v2h-6v6h-2v-6H5v-2h6z', out: 'M5 11h14v2H5z',
  fit: 'M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z',
  theme: 'M12 3a9 9 0 100 18 9 9 0 000-18zm0 2v14a7 7 0 010-14z',
};

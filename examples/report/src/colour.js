// Colours: those of the page are CSS variables, the scale of gains is viridis, turned so that the greatest gain stands out
// most from the background, without the end that the background hides.

// Viridis, every eighth of its length, sRGB.
const kViridis = [[68, 1, 84], [71, 45, 123], [59, 82, 139], [44, 114, 142], [33, 145, 140], [40, 174, 128],
  [94, 201, 98], [173, 220, 48], [253, 231, 37]];
const kPart = {light: [0.78, 0.04], dark: [0.3, 1]};
export const kRampSize = 9;

function viridis(t) {
  const x = Math.min(Math.max(t, 0), 1) * (kViridis.length - 1);
  const i = Math.min(Math.floor(x), kViridis.length - 2);
  return kViridis[i].map((value, k) => (value + (x - i) * (kViridis[i + 1][k] - value)) / 255);
}

// kRampSize colours [r, g, b] in 0 .. 1, least gain first.
export function ramp(theme) {
  const [low, high] = kPart[theme];
  return Array.from({length: kRampSize}, (_, i) => viridis(low + (i / (kRampSize - 1)) * (high - low)));
}

export const cssColour = (rgb) => `rgb(${rgb.map((x) => Math.round(255 * x)).join(' ')})`;

export const cssVariable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// [r, g, b] of a variable that holds #rrggbb.
export function rgbVariable(name) {
  const value = parseInt(cssVariable(name).slice(1), 16);
  return [(value >> 16) & 255, (value >> 8) & 255, value & 255].map((x) => x / 255);
}

// Maps gains to 0 .. 1, logarithmically where they spread over more than a factor of 30.
export function gainScale(runs) {
  let low = Infinity, high = -Infinity;
  for (const run of runs) {
    for (const gain of run.links.gain) {
      if (gain == null || !Number.isFinite(gain) || gain < 0) continue;
      low = Math.min(low, gain);
      high = Math.max(high, gain);
    }
  }
  if (low > high) return null;
  const floor = Math.max(low, high * 1e-4, 1e-9);
  const logarithmic = high > 30 * floor;
  const place = logarithmic ? (x) => Math.log(Math.max(x, floor)) : (x) => x;
  const from = place(logarithmic ? floor : low), to = place(high);
  const span = to > from ? to - from : 1;
  return {
    low: logarithmic ? floor : low, high, logarithmic,
    at: (gain) => (to > from ? (place(gain) - from) / span : 0.5),
    inverse: (t) => (logarithmic ? Math.exp(from + t * span) : from + t * span),
  };
}

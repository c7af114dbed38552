// Colours for new objects: unlike those beside them, and then far from all, and from those that stand for something else.

const LEVELS = 11; // of each channel of the colours to choose from
const APART = 0.2; // at which colours are told apart at a glance, as in coloring.rs
const UNLABELLED = [38, 38, 42];
/** Backgrounds, and unlabelled pixels, with how far off all others stay, as in palette.rs. */
const RESERVED = [[[0, 0, 0], 0.3], [[255, 255, 255], 0.12], [[128, 128, 128], 0.1], [UNLABELLED, 0.12]];

/** 8-bit sRGB to OKLab (B. Ottosson, 2020). */
function oklab(color) {
  const [r, g, b] = color.map((v) => (v <= 10.31475 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  const l = Math.cbrt(0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b);
  const m = Math.cbrt(0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b);
  const s = Math.cbrt(0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b);
  return [
    0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s,
    1.9779984951 * l - 2.428592205 * m + 0.4505937099 * s,
    0.0259040371 * l + 0.7827717662 * m - 0.808675766 * s,
  ];
}

/** The colour that differs from those of `near`, and then is farthest from all of `used`. */
function freshColor(used, near) {
  const reserved = RESERVED.map(([color, apart]) => [oklab(color), apart]);
  const [beside, taken] = [near.map(oklab), [...reserved.map(([lab]) => lab), ...used.map(oklab)]];
  const least = (lab, others) => others.reduce((least, other) => Math.min(least, Math.hypot(...minus(lab, other))), Infinity);
  let best = { color: null, apart: -1, all: -1 };
  for (let i = 0; i < LEVELS ** 3; i++) {
    const steps = [Math.floor(i / LEVELS ** 2), Math.floor(i / LEVELS) % LEVELS, i % LEVELS];
    const color = steps.map((step) => Math.floor((step * 255) / (LEVELS - 1)));
    const lab = oklab(color);
    if (reserved.some(([other, apart]) => Math.hypot(...minus(lab, other)) < apart)) continue;
    const [apart, all] = [Math.min(APART, least(lab, beside)), least(lab, taken)];
    if (apart > best.apart || (apart === best.apart && all > best.all)) best = { color, apart, all };
  }
  return best.color;
}

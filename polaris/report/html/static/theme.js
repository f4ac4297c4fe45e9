// Colours of figures in a dark page: figures are made in light colours, and recoloured as a whole before they are drawn.

const DARK = window.matchMedia("screen and (prefers-color-scheme: dark)"), INK = [230, 232, 235], PAPER = [21, 24, 28];
let printing = false; // paper is always light

const isNarrow = () => document.documentElement.clientWidth < 600;
const isDark = () => DARK.matches && !printing;
const mixed = (a, b, share) => a.map((v, k) => v + share * (b[k] - v));

function luminance(rgb) {
  const [r, g, b] = rgb.map((v) => (v <= 10 ? v / 3295 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

// Greys change places with light and dark; other colours become lighter until they stand out.
function onDark(rgb) {
  if (Math.max(...rgb) - Math.min(...rgb) < 12) return mixed(INK, PAPER, rgb[1] / 255);
  let share = 0;
  const least = 5 * (luminance(PAPER) + 0.05) - 0.05;
  while (luminance(mixed(rgb, [255, 255, 255], share)) < least && share < 1) share += 0.05;
  return mixed(rgb, [255, 255, 255], share);
}

function shade(text) {
  if (!isDark()) return text;
  return text.replace(/#([0-9a-f]{6}|[0-9a-f]{3})\b|rgba\(([\d., ]+)\)/gi, (all, hex, parts) => {
    const values = parts ? parts.split(",").map(Number)
      : [0, 1, 2].map((k) => parseInt(hex.length === 3 ? hex[k] + hex[k] : hex.slice(2 * k, 2 * k + 2), 16));
    const rgb = onDark(values.slice(0, 3)).map(Math.round).join(",");
    return parts ? `rgba(${rgb},${values[3]})` : `rgb(${rgb})`;
  });
}

// The same traces or layout in the colours of the page; texts have colours in their markup.
function themed(value, key = "") {
  if (!isDark()) return value;
  if (typeof value === "string") return /color$/.test(key) || value.includes('style="color:') ? shade(value) : value;
  if (Array.isArray(value)) return value.length && typeof value[0] === "number" ? value : value.map((one) => themed(one, key));
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([name, one]) => [name, themed(one, name)]));
}

function recolour() {
  document.querySelectorAll("[data-colour]").forEach((one) => { one.style.background = shade(one.dataset.colour); });
}

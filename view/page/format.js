// Numbers as people read them.

const missing = "–";
const known = (value) => value !== null && value !== undefined && Number.isFinite(value);

export const count = (value) => (known(value) ? Math.round(value).toString().replace(/\B(?=(\d{3})+(?!\d))/g, ",") : missing);
export const percent = (share, digits = 1) => (known(share) ? `${fixed(100 * share, digits)}%` : missing);
/** The digits of the terminal, which rounds a half to the even one. */
function fixed(value, digits) {
  const [text, exact] = [value.toFixed(digits), value.toFixed(60)];
  const end = exact.indexOf(".") + 1 + digits;
  return /^50*$/.test(exact.slice(end)) && Number(text.at(-1)) % 2 ? exact.slice(0, digits ? end : -61) : text;
}
/** A share as a percentage that is never more than there is. */
export const reached = (share) => percent(Math.floor(100 * share) / 100, 0);
export const metres = (value, digits = 3) => (known(value) ? `${fixed(value, digits)} m` : missing);
const minus = (text) => text.replace(/^-/, "−");
/** Never "-0.00". */
export const number = (value, digits = 2) => (known(value) ? minus(fixed(value, digits).replace(/^-(?=[0.]*$)/, "")) : missing);
/** A figure without its unit: the digits are those of the terminal. */
export const bare = ({ kind, unit }, value) => (kind === "share" ? percent(value) : number(value, { m: 3, steps: 1 }[unit] ?? 2));
/** A metric's mean: a share as a percentage, a value with its unit. */
export const figure = (metric, value) => `${bare(metric, value)}${metric.kind !== "share" && known(value) && metric.unit ? ` ${metric.unit}` : ""}`;
export const signed = (value, digits = 3) => (known(value) ? `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}` : missing);

export function short(value) {
  if (!known(value)) return missing;
  if (value < 0) return `−${short(-value)}`;
  if (value >= 1e6) return `${trim(value / 1e6)}M`;
  if (value >= 1e3) return `${trim(value / 1e3)}k`;
  if (value === 0) return "0";
  return value >= 100 ? value.toFixed(0) : value >= 1 ? trim(value) : value >= 0.001 ? Number(value.toPrecision(2)).toString() : value.toExponential(0);
}
const trim = (value) => Number(value.toPrecision(3)).toString();

/** Numbers along an axis, all in the same notation and with the digits that they have; null is none. */
export function ticks(values) {
  const there = values.filter(known);
  const most = Math.max(0, ...there.map(Math.abs));
  const exponent = Math.floor(Math.log10(most));
  const [unit, sign] = most >= 1e6 ? [1e6, "M"] : most >= 1e4 ? [1e3, "k"] : most && exponent < -4 ? [10 ** exponent, `e${exponent}`] : [1, ""];
  const text = (value, digits) => Number((value / unit).toFixed(digits));
  const digits = [0, 1, 2, 3, 4, 5, 6].find((digits) => there.every((value) => Math.abs(text(value, digits) - value / unit) * unit <= 1e-6 * most)) ?? 7;
  return values.map((value) => (known(value) ? minus(`${text(value, digits)}${value ? sign : ""}`) : null));
}

export function duration(seconds) {
  if (!known(seconds)) return missing;
  const all = Math.round(seconds);
  const [days, hours, minutes] = [Math.floor(all / 86400), Math.floor(all / 3600) % 24, Math.floor(all / 60) % 60];
  if (days) return `${days} d ${hours} h`;
  if (hours) return `${hours} h ${String(minutes).padStart(2, "0")} min`;
  return minutes ? `${minutes} min ${String(all % 60).padStart(2, "0")} s` : `${all} s`;
}

export const date = (unix) => (unix ? new Date(unix * 1000).toLocaleString(undefined, { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", hourCycle: "h23", timeZoneName: "short" }) : missing);
export const bytes = (value) => (known(value) ? (value >= 2 ** 30 ? `${(value / 2 ** 30).toFixed(1)} GiB` : `${Math.round(value / 2 ** 20)} MiB`) : missing);

/** What a kitchen is called, or a scene of the run's own: those are numbered from 128 on. */
export const kitchenName = (kitchen, scenes = []) => scenes[kitchen - 128] ?? `kitchen ${kitchen}`;

/** An outcome in words: "time-limit" is "time limit". `successes`: those of the task, the best first; "success" beside
 * "success-without-disturbance" is "success with disturbance". */
export function outcome(word, successes = []) {
  const [better, lacking] = successes[0]?.split("-without-") ?? [];
  if (lacking && word === better) return `${word} with ${lacking}`.replaceAll("-", " ");
  return word === "unfinished" ? "goes on" : word.replaceAll("-", " ");
}

/** A name of the task's in words, without its unit: "wrist_object_m" is "wrist to object". */
export const words = (name, unit = "") => (unit && name.endsWith(`_${unit}`) ? name.slice(0, -unit.length - 1) : name).replace(/^(wrist|object)_(object|goal)(?=_|$)/, "$1_to_$2").replaceAll("_", " ").replace(/\br prime\b/, "r′");

/** A name of the task's as a heading has it: "wrist_object_m" is "wrist to object (m)". */
export const headed = (name) => words(name).replace(/ (m|s|rad)$/, " ($1)");

/** Numbers of a channel as people read them. */
export function quantity({ name, unit, names, dtype }, numbers, named = true) {
  const one = (value) => names?.[value] ?? minus(dtype.startsWith("f") ? value.toFixed(3) : String(value));
  return `${named ? `${words(name, unit)} ` : ""}${numbers.map(one).join(", ")}${unit ? ` ${unit}` : ""}`;
}

/** An action's name in words: "MoveAheadContinuous" is "move ahead". */
export const action = (name) => (name ? name.replace(/(Continuous|MidLevel)$/, "").replace(/([a-z])([A-Z])/g, "$1 $2").replace(/\b(P|M)$/, (sign) => (sign === "P" ? "+" : "−")).replace(/([XYZ])P$/, "$1 +").replace(/([XYZ])M$/, "$1 −").replace(/HeightP$/, "Height +").replace(/HeightM$/, "Height −").replaceAll("_", " ").toLowerCase() : "start");

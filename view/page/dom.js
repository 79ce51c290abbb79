// Elements without markup in strings: what is put in is text.

const SVG = "http://www.w3.org/2000/svg";

/** A number stays on the line of its unit, and with its own digits. */
const tight = (text) => text.replace(/(\d) (?=(?:m|s|min|h|d|[MG]iB)(?!\w))/g, "$1\u00a0");

/** A text's commands, which stand in backticks, begin with the name by which the program was called. */
const marked = (child) => {
  if (typeof child !== "string") return child;
  const parts = child.split("`");
  if (parts.length % 2 === 0) return tight(child);
  return parts.map((part, at) => (at % 2 ? h("code", {}, part.replace(/^orchestrator(?= )/, app.program)) : tight(part)));
};

function fill(element, properties, children) {
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") for (const [key, each] of Object.entries(value)) element.style.setProperty(key, each);
    else if (name in element && typeof value !== "string" && element.namespaceURI !== SVG) element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...there(children));
  return element;
}

const there = (children) => children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false).flatMap(marked);

export const h = (tag, properties, ...children) => fill(document.createElement(tag), properties, children);
export const svg = (tag, properties, ...children) => fill(document.createElementNS(SVG, tag), properties, children);

export const replace = (element, ...children) => element.replaceChildren(...there(children));

/** Says it to those who do not see the page. */
export function say(text) {
  document.getElementById("said").textContent = text;
}

const inks = new Map();
const probe = document.body.appendChild(h("i", { hidden: true }));

/** The colour of this name in the style sheet, as it is now: light or dark. */
export function css(name) {
  if (!inks.has(name)) {
    probe.style.setProperty("color", `var(${name})`);
    inks.set(name, getComputedStyle(probe).color);
  }
  return inks.get(name);
}

/** Whether the page is dark: by the reader's choice, or as the system. */
export const isDark = () => document.documentElement.style.colorScheme === "dark" || (!document.documentElement.style.colorScheme && matchMedia("(prefers-color-scheme: dark)").matches);

function recolour(scheme, tell = true) {
  document.documentElement.style.setProperty("color-scheme", scheme);
  inks.clear();
  if (tell) dispatchEvent(new Event("recolour"));
}

/** Does something while all colours are those of paper. */
export async function light(work) {
  const { colorScheme } = document.documentElement.style;
  recolour("light", false);
  try { await work(); } finally { recolour(colorScheme, false); }
}

export const remembered = (key, otherwise) => { try { return JSON.parse(localStorage.getItem(key)) ?? otherwise; } catch { return otherwise; } };
export const remember = (key, value) => { try { localStorage.setItem(key, JSON.stringify(value)); } catch { /* not kept */ } };

// Light or dark: as the system, unless the reader chooses. Paper is light.
const scheme = h("select", { id: "scheme", "aria-label": "Colours", onchange: () => { recolour(scheme.value); remember("scheme", scheme.value); } },
  [["", "system"], ["light", "light"], ["dark", "dark"]].map(([value, text]) => h("option", { value }, text)));
scheme.value = remembered("scheme", "");
recolour(scheme.value, false);
document.querySelector("nav").append(scheme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => recolour(scheme.value));
addEventListener("beforeprint", () => recolour("light"));
addEventListener("afterprint", () => recolour(scheme.value));

/** Hands a blob to the reader under a name. */
export function hand(blob, name) {
  const address = URL.createObjectURL(blob);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** The name by which the program was called. */
export const app = { program: "stillroom" };

let token = "";
// Storage is of one origin: no other port of the machine reads it, as it would get a cookie.
try { token = localStorage.getItem("token") ?? ""; } catch { /* This browser keeps nothing: the address holds the token. */ }

/** Takes the token out of the address that `stillroom view` printed; whether it was there. */
export function takeToken() {
  const shown = /^#token=([\w-]+)$/.exec(location.hash)?.[1];
  if (!shown) return false;
  token = shown;
  history.replaceState(null, "", "/");
  try { localStorage.setItem("token", token); } catch { /* As above. */ }
  return true;
}

/** The events of a path. Their request can have no header. */
export const follow = (path) => new EventSource(withToken(path));

/** An address for what can send no header. */
export const withToken = (path) => `${path}?token=${token}`;

/** Resolves after a while, or when the page is left. */
export const pause = (milliseconds, signal) => new Promise((resolve) => {
  const timer = setTimeout(resolve, milliseconds);
  signal?.addEventListener("abort", () => { clearTimeout(timer); resolve(); }, { once: true });
});

/** A viewer that is busy, or that reads a recording first, answers 503: how often it is asked again, and how soon, ms. */
const AGAIN = 60;
const AGAIN_MS = 1000;

/** The answer to a request. `waits`: called with the reason while the viewer cannot answer yet. */
export async function ask(path, { waits, ...options } = {}) {
  for (let left = AGAIN; ; left -= 1) {
    let answer;
    try {
      answer = await fetch(path, { ...options, headers: { Authorization: `Bearer ${token}` } });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new Error(`the viewer does not answer: is \`${app.program} view\` still there?`);
    }
    if (answer.ok) return answer;
    const text = await answer.text();
    let problem = text.trim();
    try { problem = JSON.parse(text).error ?? problem; } catch { /* plain text */ }
    if (answer.status !== 503 || !left) throw new Error(problem || `the viewer answered ${answer.status}`);
    waits?.(problem);
    await pause(AGAIN_MS, options.signal);
  }
}

export const json = async (path, options) => (await ask(path, options)).json();

export const notice = (text, kind = "") => h("p", { class: `notice ${kind}`, role: kind === "error" ? "alert" : null }, text);

/** What figures mean, folded away; of those that have a name and a text. */
export function meanings(described, title) {
  const known = described.filter(({ label, doc }) => label && doc);
  const summary = title ?? `What ${known.slice(0, 3).map(({ label }) => label).join(", ")}${known.length > 3 ? " …" : ""} mean`;
  return known.length ? h("details", {}, h("summary", { class: "small soft" }, summary), h("ul", { class: "small soft wide" }, known.map(({ label, doc }) => h("li", {}, `${label}: ${doc}`)))) : null;
}

/** A command, and a button that copies it: where the browser has no clipboard, the whole is marked. */
export function command(text) {
  const code = h("code", { class: "small" }, text);
  const copy = async () => {
    getSelection().selectAllChildren(code);
    await navigator.clipboard?.writeText(text).then(() => say("copied"), () => {});
  };
  return [h("button", { class: "small", onclick: copy }, "copy"), " ", code];
}

/** Does something again and again until the page is left; `work` may be slow, calls never overlap. */
export function every(milliseconds, signal, work) {
  const round = async () => {
    if (signal.aborted) return;
    if (!document.hidden) await work();
    if (!signal.aborted) setTimeout(round, milliseconds);
  };
  round();
}

/** Says what is waited for, and counts the seconds while it is on the page. `words`: may be put in other words; `renew`: counts anew. */
export function waiting(text, signal) {
  const [words, taken] = [h("span", {}, text), h("span", { "aria-hidden": "true" })];
  const element = h("p", { class: "soft", role: "status" }, words, taken);
  let [begun, shown] = [performance.now(), false];
  const timer = setInterval(() => {
    shown ||= element.isConnected;
    if (signal.aborted || (shown && !element.isConnected)) clearInterval(timer);
    else { const seconds = Math.floor((performance.now() - begun) / 1000); taken.textContent = seconds ? ` … ${seconds} s` : ""; }
  }, 1000);
  const renew = (other) => { replace(words, other); taken.textContent = ""; begun = performance.now(); };
  return { words, element, renew };
}

/** Heads of columns that sort by a click: largest first, smallest first, and back. `asked` has `sort` and `descending`. */
export function sorters(columns, asked, changed) {
  return columns.map(([label, name, kind]) => h("th", { scope: "col", class: kind, "aria-sort": "none", "data-column": name }, h("button", {
    onclick: () => {
      [asked.sort, asked.descending] = asked.sort !== name ? [name, "true"] : asked.descending === "true" ? [name, ""] : ["", ""];
      changed();
    },
  }, label)));
}

/** The same as one select, for a screen too narrow for heads. */
export function orders(asked, changed) {
  const select = h("select", { onchange: () => {
    const [sign, ...name] = select.value;
    [asked.sort, asked.descending] = [name.join(""), sign === "-" ? "true" : ""];
    changed();
  } });
  return h("label", { class: "orders" }, "sort by", select);
}

/** Shows in heads and in their select what is sorted by. */
export function showOrder(heads, asked, label) {
  heads.forEach((one) => one.setAttribute("aria-sort", asked.sort !== one.dataset.column ? "none" : asked.descending === "true" ? "descending" : "ascending"));
  const select = label.lastChild;
  const entries = heads.flatMap(({ textContent, dataset: { column } }) => [["-", "↓"], ["+", "↑"]].map(([sign, arrow]) => [`${sign}${column}`, `${textContent} ${arrow}`]));
  if (select.dataset.entries !== entries.join()) replace(select, h("option", { value: "" }, "newest"), entries.map(([value, text]) => h("option", { value }, text)));
  select.dataset.entries = entries.join();
  select.value = asked.sort && `${asked.descending ? "-" : "+"}${asked.sort}`;
}

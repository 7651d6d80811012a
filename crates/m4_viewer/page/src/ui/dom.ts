/** Finding and making elements, with types. */

/** The element that `selector` names; the page is broken without it. */
export function find<T extends Element>(kind: new () => T, selector: string, root: ParentNode = document): T {
  const element = root.querySelector(selector);
  if (!(element instanceof kind)) throw new Error(`the page has no ${selector}`);
  return element;
}

/** The element of a control. */
export const control = <T extends HTMLElement>(kind: new () => T, name: string): T =>
  find(kind, `[data-control="${name}"]`);

/** A new element with a class and text or children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** A new SVG element. */
export function makeSvg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  attributes: Readonly<Record<string, string>> = {},
): SVGElementTagNameMap[K] {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** An icon of the sprite in the page. */
export function icon(name: string): SVGSVGElement {
  const svg = makeSvg("svg");
  svg.append(makeSvg("use", { href: `#i-${name}` }));
  return svg;
}

/** Shows another icon in a button. */
export function setIcon(button: HTMLElement, name: string): void {
  const use = button.querySelector("use");
  if (use && use.getAttribute("href") !== `#i-${name}`) use.setAttribute("href", `#i-${name}`);
}

export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function setAttribute(element: Element, name: string, value: string): void {
  if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

/** A range input with the part up to its value in the accent colour. */
export function fillRange(input: HTMLInputElement): void {
  const [low, high] = [Number(input.min), Number(input.max)];
  const share = high > low ? (Number(input.value) - low) / (high - low) : 0;
  // the thumb is 16 px wide and stays inside the track
  input.style.setProperty("--share", `calc(8px + ${share.toFixed(5)} * (100% - 16px))`);
}

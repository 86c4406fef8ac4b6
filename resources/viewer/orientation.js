import {radians} from "./camera.js";
import {byId, select} from "./elements.js";
import {niceBelow} from "./texts.js";

/** @import {Camera} from "./camera.js" */
const BAR_PX = 120; // at most

/**
 * The north arrow and the scale bar.
 * @param {Camera} camera
 */
export function showOrientation(camera) {
  const flat = Math.max(Math.cos(radians(camera.tilt)), 0.35);
  select(SVGGElement, byId("north"), "g").setAttribute("transform", `scale(1 ${flat}) rotate(${-camera.bearing})`);
  const perMetre = camera.pixelsPerMetre(camera.distance);
  const metres = niceBelow(BAR_PX / perMetre);
  select(HTMLElement, byId("scale"), "span").textContent = metres >= 1000 ? `${metres / 1000} km` : `${metres} m`;
  select(HTMLElement, byId("scale"), "div").style.width = `${metres * perMetre}px`;
}

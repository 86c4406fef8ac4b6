import {byId, inputOf} from "./elements.js";
import {decimalsOf} from "./texts.js";

/** @import {Layer} from "./contents.js" */
/** @import {Drawing} from "./drawing.js" */

/** The choice of the layer that is shown, and its legend. */
export class Legend {
  /**
   * @param {Drawing} drawing
   * @param {Layer[]} layers
   */
  constructor(drawing, layers) {
    this.drawing = drawing;
    this.layers = layers;
    this.choices = layers.map((layer, index) => this.#choice(layer, index));
  }

  /**
   * @param {Layer} layer
   * @param {number} index
   */
  #choice(layer, index) {
    const label = document.createElement("label");
    const choice = document.createElement("input");
    Object.assign(choice, {type: "radio", name: "layer"});
    choice.addEventListener("change", () => this.show(index));
    label.append(choice, ` ${layer.title}`);
    byId("layers").append(label);
    return choice;
  }

  /** @param {number} index */
  show(index) {
    const layer = this.layers[index];
    this.choices[index].checked = true;
    inputOf("shade").checked = !layer.picture; // a photo has shadows of its own
    Object.assign(this.drawing, {layer, shade: !layer.picture});
    byId("legend").hidden = !layer.ramp.length;
    if (layer.ramp.length) {
      byId("ramp").style.background = `linear-gradient(to right,${layer.ramp.join()})`;
      const decimals = Math.min(decimalsOf(layer), 2);
      [layer.low, (layer.low + layer.high) / 2, layer.high].forEach((value, i) => {
        byId("limits").children[i].textContent = `${value.toFixed(decimals)} m`;
      });
    }
    this.drawing.draw();
  }
}

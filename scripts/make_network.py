"""Writes the network of the learned matching cost from the wheel of CNES's package ``mccnn``.

    pip download --no-deps --dest wheels mccnn==1.4.1
    pip install onnx
    python scripts/make_network.py wheels/mccnn-1.4.1-*.whl

The wheel's file has shapes that are computed while it runs, which OpenCV does not read. The weights are the same; the
graph has the five blocks alone, and the engine divides features by their length itself.
"""

from __future__ import annotations

import importlib
import pathlib
import sys
import zipfile

onnx = importlib.import_module("onnx")  # needed here alone: neither tests nor the engine have it
helper, numpy_helper = onnx.helper, onnx.numpy_helper

SOURCE = "mc_cnn/weights/mc_cnn_fast_dw.onnx"
TARGET = pathlib.Path(__file__).resolve().parents[1] / "repm_qgis" / "matching" / "networks" / "mc_cnn_fast_dw.onnx"
LAYERS = (0, 1, 3, 4, 6, 7, 9, 10, 12, 13)  # depthwise and pointwise convolutions in turns
BEFORE_RELU = LAYERS[1:-1:2]


def static_graph(data: bytes) -> bytes:
    """The network in an ONNX file whose shapes do not depend on its input."""
    weights = {part.name: numpy_helper.to_array(part) for part in onnx.load_from_string(data).graph.initializer}
    nodes, values, image = [], [], "image"
    for layer in LAYERS:
        kernel, bias = (weights[f"conv_blocks.{layer}.{part}"] for part in ("weight", "bias"))
        values += [numpy_helper.from_array(kernel, f"kernel{layer}"), numpy_helper.from_array(bias, f"bias{layer}")]
        side, group = kernel.shape[-1], kernel.shape[0] if kernel.shape[-1] > 1 else 1
        inputs = [image, f"kernel{layer}", f"bias{layer}"]
        nodes.append(helper.make_node("Conv", inputs, [f"sum{layer}"], kernel_shape=[side, side], group=group))
        image = f"sum{layer}"
        if layer in BEFORE_RELU:
            nodes.append(helper.make_node("Relu", [image], [f"positive{layer}"]))
            image = f"positive{layer}"
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
        for name, shape in (("image", [1, 1, 64, 64]), (image, [1, 64, 54, 54]))
    ]
    graph = helper.make_graph(nodes, "mc_cnn_fast_dw", ends[:1], ends[1:], values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 11)], producer_name="")
    model.ir_version = 6
    written: bytes = model.SerializeToString()
    return written


def main(wheel: str) -> int:
    with zipfile.ZipFile(wheel) as archive:
        TARGET.write_bytes(static_graph(archive.read(SOURCE)))
    print(f"{TARGET.name}: {TARGET.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

"""An RPC as each format writes it, for formats and numbers that the data folder has no file of.

Written from the formats' descriptions, not with the readers' tables, so that one can be wrong without the other.
"""

from __future__ import annotations

import json

from repm_qgis.rpc import Rpc


def _digits(value: float) -> str:
    """All digits of a number; numpy's own numbers have their type around them since numpy 2."""
    return repr(float(value))


def _scalars(rpc: Rpc):
    """(name of the axis, offset, scale), in the order of RPC00B."""
    return (
        ("LINE", rpc.row_off, rpc.row_scale),
        ("SAMP", rpc.col_off, rpc.col_scale),
        ("LAT", rpc.lat_off, rpc.lat_scale),
        ("LONG", rpc.lon_off, rpc.lon_scale),
        ("HEIGHT", rpc.height_off, rpc.height_scale),
    )


def _polynomials(rpc: Rpc):
    return (("LINE_NUM", rpc.row_num), ("LINE_DEN", rpc.row_den), ("SAMP_NUM", rpc.col_num), ("SAMP_DEN", rpc.col_den))


def key_value(rpc: Rpc, units: bool = True, width: int = 1) -> str:
    """``_RPC.TXT``: IKONOS with units, Planet and SkySat without; ``width`` 2 counts coefficients 01, 02, ..."""
    unit = {"LINE": " pixels", "SAMP": " pixels", "LAT": " degrees", "LONG": " degrees", "HEIGHT": " meters"}
    lines = [f"{axis}_OFF: {_digits(off)}{unit[axis] if units else ''}" for axis, off, _ in _scalars(rpc)]
    lines += [f"{axis}_SCALE: {_digits(scale)}{unit[axis] if units else ''}" for axis, _, scale in _scalars(rpc)]
    for name, values in _polynomials(rpc):
        lines += [f"{name}_COEFF_{i:0{width}d}: {_digits(value)}" for i, value in enumerate(values, start=1)]
    return "\n".join(lines) + "\n"


def whu_tlc(rpc: Rpc) -> str:
    """WHU-TLC's ``.rpc``: the above and the 80 coefficients of the inverse model, which here are any numbers."""
    lines = [
        f"{name}_COEFF_{i}: {0.01 * i + 0.001!r}"
        for name in ("LAT_NUM", "LAT_DEN", "LONG_NUM", "LONG_DEN")
        for i in range(1, 21)
    ]
    return key_value(rpc) + "\n".join(lines) + "\n"


def rpb(rpc: Rpc) -> str:
    """DigitalGlobe's ``.RPB``."""
    axis = {"LINE": "line", "SAMP": "samp", "LAT": "lat", "LONG": "long", "HEIGHT": "height"}
    lines = [
        'satId = "WV03";',
        'bandId = "P";',
        'SpecId = "RPC00B";',
        "BEGIN_GROUP = IMAGE",
        "\terrBias =  1.09;",
        "\terrRand =  0.24;",
    ]
    lines += [f"\t{axis[name]}Offset = {_digits(off)};" for name, off, _ in _scalars(rpc)]
    lines += [f"\t{axis[name]}Scale = {_digits(scale)};" for name, _, scale in _scalars(rpc)]
    for name, (_, values) in zip(("lineNumCoef", "lineDenCoef", "sampNumCoef", "sampDenCoef"), _polynomials(rpc)):
        *first, last = map(_digits, values)
        lines += [f"\t{name} = (", *(f"\t\t\t{value}," for value in first), f"\t\t\t{last});"]
    return "\n".join(lines) + "\nEND_GROUP = IMAGE\nEND;\n"


def _dimap(rpc: Rpc, first: int, profile: str, version: str, forward: str, back: str, back_names: tuple) -> str:
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<Dimap_Document version="{version}">',
        "<Metadata_Identification>",
        f'<METADATA_FORMAT version="{version}">DIMAP</METADATA_FORMAT>',
        f"<METADATA_PROFILE>{profile}</METADATA_PROFILE>",
        "</Metadata_Identification>",
        "<Rational_Function_Model>",
        "<Global_RFM>",
        f"<{back}>",
    ]
    lines += [f"<{name}_COEFF_{i}>{0.5 + i}</{name}_COEFF_{i}>" for name in back_names for i in range(1, 21)]
    lines += [f"</{back}>", f"<{forward}>"]
    lines += [
        f"<{name}_COEFF_{i}>{_digits(value)}</{name}_COEFF_{i}>"
        for name, values in _polynomials(rpc)[::-1]
        for i, value in enumerate(values, start=1)
    ]
    lines += [
        "<ERR_BIAS_ROW>0.001</ERR_BIAS_ROW>",
        f"</{forward}>",
        "<RFM_Validity>",
        f"<{back}_Validity_Domain>",
        "<FIRST_ROW>-3</FIRST_ROW>",
        f"</{back}_Validity_Domain>",
    ]
    for axis, off, scale in _scalars(rpc):
        shift = first if axis in ("LINE", "SAMP") else 0
        lines += [f"<{axis}_SCALE>{_digits(scale)}</{axis}_SCALE>", f"<{axis}_OFF>{_digits(off + shift)}</{axis}_OFF>"]
    lines += ["</RFM_Validity>", "</Global_RFM>", "</Rational_Function_Model>", "</Dimap_Document>"]
    return "\n".join(lines) + "\n"


def dimap_v2(rpc: Rpc, profile: str = "PHR_SENSOR") -> str:
    """Pleiades and SPOT 6/7: pixels count from 1."""
    return _dimap(
        rpc, 1, profile, "2.15", "Inverse_Model", "Direct_Model", ("SAMP_NUM", "SAMP_DEN", "LINE_NUM", "LINE_DEN")
    )


def dimap_v3(rpc: Rpc) -> str:
    """Pleiades Neo: other names, and pixels count from 0."""
    return _dimap(
        rpc,
        0,
        "PNEO_SENSOR",
        "3.0",
        "GroundtoImage_Values",
        "ImagetoGround_Values",
        ("LON_NUM", "LON_DEN", "LAT_NUM", "LAT_DEN"),
    )


def maxar_xml(rpc: Rpc) -> str:
    """The XML beside a WorldView image: another IMAGE block comes before the RPC's."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<isd>",
        "<IMD>",
        "<IMAGE>",
        "<SATID>WV02</SATID>",
        "</IMAGE>",
        "</IMD>",
        "<RPB>",
        "<SATID>WV02</SATID>",
        "<IMAGE>",
        "<ERRBIAS>2.668e+01</ERRBIAS>",
    ]
    lines += [f"<{axis}OFFSET>{_digits(off)}</{axis}OFFSET>" for axis, off, _ in _scalars(rpc)]
    lines += [f"<{axis}SCALE>{_digits(scale)}</{axis}SCALE>" for axis, _, scale in _scalars(rpc)]
    for name, values in _polynomials(rpc):
        tag = name.replace("_", "") + "COEF"
        lines += [f"<{tag}List>", f"<{tag}>{' '.join(map(_digits, values))}</{tag}>", f"</{tag}List>"]
    return "\n".join(lines + ["</IMAGE>", "</RPB>", "</isd>"]) + "\n"


# The powers of longitude L, latitude P and height H in each of the twenty terms (NIMA STDI-0002).
RPC00A = "1 L P H LP LH PH LPH LL PP HH LLL LLP LLH LPP PPP PPH LHH PHH HHH".split()
RPC00B = "1 L P H LP LH PH LL PP HH LPH LLL LPP LHH LLP PPP PHH LLH PPH HHH".split()


def geom(rpc: Rpc, order: str = "B") -> str:
    """OSSIM's and Orfeo ToolBox's ``.geom``: counts coefficients from 00."""
    lines = [
        "adjustment_0.adj_param_0.center:  0",
        "adjustment_0.adj_param_0.description:  intrack_offset",
        "adjustment_0.adj_param_0.parameter:  0",
        "adjustment_0.adj_param_0.sigma:  50",
    ]
    for axis, off, scale in _scalars(rpc):
        lines += [f"{axis.lower()}_off:  {_digits(off)}", f"{axis.lower()}_scale:  {_digits(scale)}"]
    terms = RPC00A if order == "A" else RPC00B
    for name, values in _polynomials(rpc):
        of_term = dict(zip(RPC00B, values))
        lines += [f"{name.lower()}_coeff_{i:02d}:  {of_term[term]!r}" for i, term in enumerate(terms)]
    return "\n".join(lines + [f"polynomial_format:  {order}", "type:  ossimRpcModel"]) + "\n"


def rpcm_json(rpc: Rpc) -> str:
    """The JSON of the DFC2019 crops: rpcm's dictionary under "rpc"."""
    names = {"LINE": "row", "SAMP": "col", "LAT": "lat", "LONG": "lon", "HEIGHT": "alt"}
    record = {f"{names[axis]}_offset": off for axis, off, _ in _scalars(rpc)}
    record.update({f"{names[axis]}_scale": scale for axis, _, scale in _scalars(rpc)})
    record.update(row_num=rpc.row_num, row_den=rpc.row_den, col_num=rpc.col_num, col_den=rpc.col_den)
    return json.dumps(
        {
            "img": "JAX_004_001_RGB.tif",
            "width": 800,
            "height": 811,
            "geojson": {"coordinates": [[[1.0, 2.0], [3.0, 4.0]]], "type": "Polygon"},
            "rpc": record,
        },
        indent=1,
    )


def gdal_json(rpc: Rpc) -> str:
    """GDAL's names with texts for numbers, as S2P's configurations hold them."""
    record = {f"{axis}_OFF": _digits(off) for axis, off, _ in _scalars(rpc)}
    record.update({f"{axis}_SCALE": _digits(scale) for axis, _, scale in _scalars(rpc)})
    record.update({f"{name}_COEFF": " ".join(map(_digits, values)) for name, values in _polynomials(rpc)})
    return json.dumps(record, indent=1)


WRITERS = {
    "IKONOS": key_value,
    "Planet": lambda rpc: key_value(rpc, units=False),
    "WHU-TLC": whu_tlc,
    "RPB": rpb,
    "DIMAP v2": dimap_v2,
    "DIMAP v3": dimap_v3,
    "Maxar XML": maxar_xml,
    "OSSIM B": geom,
    "OSSIM A": lambda rpc: geom(rpc, "A"),
    "JSON rpcm": rpcm_json,
    "JSON GDAL": gdal_json,
}
"""All of them by the formats' names."""

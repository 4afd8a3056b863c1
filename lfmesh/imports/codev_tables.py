"""Lookup tables for the CODE V reader: names of commands, units and standard conditions."""

import re

from lfmesh.imports.text import command_names

UNITS_MM = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4}

TEMPERATURES_C, PRESSURES = (20.0, 22.0), (1.0, 760.0)
"""Standard conditions: catalogue temperatures in °C, and sea-level air pressure in atmospheres or mm of mercury."""

MIRRORS = "mirrors are not supported: the lens refracts"

COEFFICIENTS = "ABCDEFGHJ"
"""Coefficients of r⁴, r⁶, ... r²⁰."""

NO_GRADIENTS = "gradient indices of CODE V are not supported"

GRADIENTS = ("URN", "SEL", "SPG", "USG")
"""Formulas of private glasses with a gradient index. They are not public."""

WITHOUT_EFFECT = command_names(
    "LEN GO CA INI WTW WTF SLB CCY THC CUM THM GLC KC AC BC CC DC EC FC GC HC JC DER CLS PIM CVS HCC "
    "ADC BDC CDC XDC YDC ZDC CPR POL SPH ORD AFI UM UMY HMY IMY"
)
"""Labels, weights, optimisation variables, solves (their present value is in the surface's line), drawing."""

REFUSED = {
    **dict.fromkeys(["XTO", "YTO", "CYL", "AAS", "RDX", "CUX", "KX", "KY"], "toroids and biconics are not supported"),
    **dict.fromkeys(["SPS", "QBF", "QCN", "ODD", "XYP", "ZRN", "UDS"], "special surfaces are not supported"),
    **dict.fromkeys(["GRN", "URN", "GRC"], NO_GRADIENTS),
    **dict.fromkeys(["REX", "REY"], "rectangular apertures are not supported"),
    **dict.fromkeys(["ELX", "ELY"], "elliptical apertures are not supported"),
    **dict.fromkeys(["ADX", "ADY"], "decentred apertures are not supported"),
    **dict.fromkeys(["NSS", "ENS"], "non-sequential groups are not supported"),
    "BEN": "an axis that bends at a mirror is not supported",
    "GLB": "surfaces placed from any but the previous surface are not supported",
    **dict.fromkeys(
        ["INS", "DEL", "COP", "SCA", "FLI"], "commands that edit the lens are not run; save what they make"
    ),
}

MOVES = ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE")
"""Decentres of a surface: shifts along x, y and z, then rotations about its own x and y axes (left-handed) and z axis
(right-handed), the convention of CODE V according to LightTools' manual."""

RETURNS = ("DAR", "REV")
"""Decentres that return the axis. With DAR, they move only the surface; with REV, the surface stays and what follows is
moved back, which undoes an earlier decentre of equal values. ray-optics does the same."""

SURFACE_NAME = re.compile(r"S(O|I|S|\d+)(\.\.\S+)?$")

FIELDS = {"AN": "angle", "OB": "object", "IM": "image", "RI": "image"}

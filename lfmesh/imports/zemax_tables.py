"""Lookup tables for the Zemax reader: names, parameter numbers and units."""

from lfmesh.imports.text import command_names

UNITS_MM = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "METER": 1000.0, "M": 1000.0}

FIELD_KINDS = {0: "angle", 1: "object", 2: "image", 3: "image"}

WITHOUT_EFFECT = command_names(
    "VERS AUTH PFIL LANG MOFF RAIM PUSH SDMA OMMA ROPD HYPR PICB POLS GLRS GSTD NSCD BLNK TOL DBDT FWGN FWGT WWGT "
    "WWGN WAVN VANN GFAC COMM SLAB HIDE MIRR MEMA OEMA POPS PZUP MAZH VDSZ VPAR PPAR PRAM STKP FCOM BRDF SSID "
    "TCED TCEX TCMM WFNO RCMF FIMP XDAF"
)
"""Names, program settings, solves (their present value is in the line), drawing, mechanics."""

EXTENDED = {"XASPHERE": 2, "XOSPHERE": 1}
"""Aspheres in powers of r over a normalisation radius, in XDAT, with the step of the power between terms."""

ASPHERES = ("EVENASPH", "ODDASPHE", *EXTENDED)

FORBES = "QED_TYPE"
"""Forbes' aspheres. XDAT 1 is 0 for mild and 1 for strong ones, 2 the number of terms, 3 the normalisation radius, the
rest the coefficients from a₀. This follows a catalogue lens (ASL5040-UV of Thorlabs), which focuses sharply at 405
nm with the deviation along the normal of its conic."""

FIRST_TERM = {FORBES: 4, **dict.fromkeys(EXTENDED, 3)}
"""Place of the first coefficient in XDAT, behind the number of terms and the radius."""

BEFORE_EXTRA = 12
"""Parameters of a surface before its extra data.

OpticStudio's help, 24.2, "Extended Asphere", counts the number of terms, the radius and the coefficients as parameters
13, 14 and 15 to 254, which are XDAT 1, 2 and 3 to 242. It gives no meaning to parameters 1 to 12.
"""

SECTIONS = {"BICONICX": "biconic", "TOROIDAL": "toroid"}
"""Surfaces with a different section in x. Parameter 1 is its radius, 0 if flat. Parameter 2 is the conic constant of a
biconic; a toroid has the coefficients of y², y⁴, ... from parameter 2 on.

Checked against OpticStudio's online help, 24.2, "Toroidal" (parameters 0 Extrapolate, 1 radius of rotation, 2 to 8 the
coefficients, 13 number of Zernike terms), and 26.1, "Odd Asphere" (1 to 8: r to r⁸). No vendor's page on the sequential
biconic was available: the help's biconic object has a radius in x, 0 if flat, as pyrate reads it; prysm takes parameter
1 for a curvature.
"""

MOST_EXTRA = 1000

LAST_OF_TOROID, ZERNIKE_TERMS = 8, 13
"""Parameters of a toroid: the coefficient of y¹⁴, and the number of Zernike terms."""

OF_ZERNIKE_TERMS = 0, 14
"""Parameters of a toroid without meaning unless it has Zernike terms: extrapolation beyond their radius, and that
radius."""

ORDER_OF_BREAK = 6
"""Parameter of a coordinate break: 0 shifts and then tilts about x, y and z, others tilt about z, y and x first. It
follows the shifts in x and y and the three right-handed angles, each about the axes left by the previous one
(Zemax's "Rotation Matrix and Tilt About X/Y/Z in OpticStudio"; the sign also by its help, 24.2, "Tilt/Decenter", and
the global coordinates of a chain of prisms listed in its article 194)."""

REFUSED_TYPES = {
    "XODDASPH": "extended odd aspheres are not supported",
    "XPOLYNOM": "surfaces without rotational symmetry are not supported",
    "SZERNSAG": "surfaces without rotational symmetry are not supported",
    "BINARY_4": "a variable number of zones with phases of their own is not supported",
    "SZERNPHA": "phases of standard Zernike polynomials are not supported",
    "GRINSUR6": "gradient-index glass of GLC.DAT is not supported",
    "GRINSU11": "gradient-index glass on a grid is not supported",
    "NONSEQCO": "non-sequential groups are not supported",
    "FRESNELS": "Fresnel surfaces are not supported",
    "IRREGULA": "irregular surfaces are not supported",
}

APERTURES_REFUSED = {
    "OBSC": "a central obscuration",
    "SQOB": "a rectangular obscuration",
    "ELOB": "an elliptical obscuration",
    "ELAP": "an elliptical aperture",
    "SPID": "a spider",
    "UDAD": "an aperture drawn by the user",
    "UDOB": "an obscuration drawn by the user",
}

THERMAL = 20.0, 1.0

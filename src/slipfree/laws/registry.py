"""Names of the slip laws and wheel-ground laws in problem files.

A slip law determines the rates of a kinematic model that the contact constraints do not determine;
a wheel-ground law gives the forces of the ground on the wheels of a quasi-static model, and a
contact law those on the wheels of a dynamic model. Each law is a frozen dataclass in its own file,
with one line in this file.
"""

from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import ContactLaw, GroundLaw, SlipLaw
from slipfree.laws.rolling import Rolling
from slipfree.laws.soil import Soil

SLIP_LAWS: dict[str, type[SlipLaw]] = {
    "least": LeastSlip,
    "rolling": Rolling,
}
GROUND_LAWS: dict[str, type[GroundLaw]] = {
    "coulomb": Coulomb,
    "linear_creep": LinearCreep,
    "soil": Soil,
}
CONTACT_LAWS: dict[str, type[ContactLaw]] = {
    "compliant": Compliant,
    "soil": Soil,
}

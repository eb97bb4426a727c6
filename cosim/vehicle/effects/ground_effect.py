"""Ground effect of a vehicle that hovers on jets: loss of lift, and hot gas that the engines swallow."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.spec.vehicle import GroundEffect, Jet
from cosim.vehicle.effects.effect import Effect, Load


def lift_loss(height: float, planform: float, jet: float, least_height: float = 0.3) -> float:
    """Return the fraction of the thrust that a jet's entrainment between planform and ground takes.

    Wyatt's correlation (Static tests of ground effect on planforms fitted with a centrally-located round lifting jet,
    ARC CP 749, 1964, as later reports quote it):

        dL / T = 0.012 (h / (D - d))^-2.3

    ``height`` h of the planform above the ground [m], ``planform`` its angular mean diameter D [m], ``jet`` the
    diameter d of its one round jet [m].  Chosen by us: it is constant below ``least_height`` times (D - d), as the law
    has no limit towards the ground, and lift loss has.
    """
    span = planform - jet
    return float(0.012 * max(height / span, least_height) ** -2.3)


class LiftLoss(Effect):
    """Effect of the jets' lift loss near the ground.

    The loss pulls along body z, through the centre of gravity; all jets count as one of their joint area.
    """

    def __init__(self, effect: GroundEffect, jets: Sequence[Jet]) -> None:
        self._planform, self._jet, self._below = effect.planform_m, effect.jet_m, effect.planform_z_m
        # The loss is distributed over the stations with this mean position, and its moment is compensated.
        self._mean_x = sum([jet.position_m[0] for jet in jets]) / len(jets)
        self._mean_y = sum([jet.position_m[1] for jet in jets]) / len(jets)

    def add_to(self, load: Load) -> None:
        """Subtract the lift loss from the jets' forces, and cancel its moment about the centre of gravity."""
        forces, state = load.forces, load.state
        lift = -sum([z for _, _, z in forces])
        if lift <= 0.0:
            return
        loss = lift * lift_loss(state.altitude - self._below, self._planform, self._jet)
        part = loss / len(forces)
        load.forces = [(x, y, z + part) for x, y, z in forces]
        load.add_moment((-self._mean_y * loss, self._mean_x * loss, 0.0))


class HotGas:
    """Effect of exhaust gas that the ground reflects into the intakes."""

    def __init__(self, effect: GroundEffect) -> None:
        self._heights = list(effect.hot_gas_height_m)
        self._rises = list(effect.hot_gas_rise_k)

    def temperature_rise(self, altitude: float) -> float:
        """Return the temperature of the intakes over that of the air [K] at ``altitude`` [m] of the centre of gravity.

        Linear between the heights of the table, constant below the first; the last one's is zero.
        """
        heights, rises = self._heights, self._rises
        if altitude <= heights[0]:
            return rises[0]
        for i in range(1, len(heights)):
            if altitude < heights[i]:
                fraction = (altitude - heights[i - 1]) / (heights[i] - heights[i - 1])
                return rises[i - 1] + fraction * (rises[i] - rises[i - 1])
        return 0.0

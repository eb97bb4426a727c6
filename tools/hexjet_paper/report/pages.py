"""The tables of docs/paper.md between its marks, as Markdown."""

from __future__ import annotations

from collections.abc import Iterable
from math import radians
from typing import TYPE_CHECKING

from cosim.pages import table
from hexjet_paper import numbers
from hexjet_paper.claims import ClaimRow, Evidence, Judgement
from hexjet_paper.experiments import Metrics, Result
from hexjet_paper.report.figures import FIDELITIES, NAMES
from hexjet_paper.report.page import count_choices, tally, verified_in_words
from hexjet_paper.report.readings import model_error_table, readings_table

if TYPE_CHECKING:
    from hexjet_paper.report.result import Reproduction

COUNTS, DOUBLET, HELD_CLAIMS, DIFFERS, CONSTRUCTED, TURBOJET = (  # names of tables
    "paper: " + part for part in ("counts", "doublet", "held", "differs", "by construction", "turbojet")
)
READINGS, CONSISTENT, VERIFIED, OFF = (  # names of tables
    "paper: " + part for part in ("readings", "consistency", "verification", "model errors")
)
TABLES = (COUNTS, DOUBLET, HELD_CLAIMS, DIFFERS, CONSTRUCTED, TURBOJET, READINGS, CONSISTENT, VERIFIED, OFF)


def page_parts(reproduction: Reproduction) -> dict[str, str]:
    """Return the generated parts of documentation pages by the names of their marks."""
    return {
        COUNTS: counts_table(reproduction.claims),
        DOUBLET: _make_doublet_table(reproduction),
        HELD_CLAIMS: _list_held_claims(reproduction),
        DIFFERS: _make_differences_table(reproduction),
        CONSTRUCTED: constructed_table(reproduction.claims),
        TURBOJET: _make_turbojet_table(reproduction),
        READINGS: readings_table(reproduction.readings).markdown(),
        CONSISTENT: _make_consistency_table(reproduction.consistency),
        VERIFIED: verified_in_words(reproduction) + "\n",
        OFF: model_error_table(reproduction.model_errors).markdown(),
    }


def counts_table(claims: Iterable[ClaimRow]) -> str:
    """Return the table of the number of claims of each verdict, by fidelity."""
    claims = list(claims)
    counts, chosen = tally(claims), dict(zip(FIDELITIES, count_choices(claims), strict=True))
    labels = {
        "holds": "holds",
        "under a condition": "holds under a stated condition",
        "by construction": "holds by construction: no evidence",
        "does not hold": "does not hold",
        "not flown": "not flown",
    }
    rows = [(label, *(str(counts[name][verdict]) for name in FIDELITIES)) for verdict, label in labels.items()]
    rows.insert(1, ("of these, by a choice of ours", *(str(chosen[name]) for name in FIDELITIES)))
    rows.append(("claims", *(str(sum(counts[name].values())) for name in FIDELITIES)))
    return table(("verdict", *FIDELITIES), rows, left=1)


def constructed_table(claims: Iterable[ClaimRow]) -> str:
    """Return the table of claims that hold by construction, with the reasons."""
    rows = []
    for row in claims:
        where = [
            name
            for name, judged in zip(FIDELITIES, (row.linear, row.flight), strict=True)
            if judged is not None and judged.verdict == "by construction"
        ]
        if where:
            rows.append((row.claim, " and ".join(where), row.linear.basis, row.rests_on))
    return table(("claim", "by construction on", "ours is", "because"), rows, left=4)


def _make_consistency_table(rows: Iterable[ClaimRow]) -> str:
    """Return the table on whether printed numbers are consistent, by fidelity."""
    cells = [
        (row.claim, row.linear.verdict, row.flight.verdict if row.flight else "not flown", row.linear.condition)
        for row in rows
    ]
    return table(("question", *FIDELITIES, "condition"), cells, left=4)


def _make_doublet_table(reproduction: Reproduction) -> str:
    """Return the table of the Hex-Jet's roll doublet at the gains of vehicle.toml, flown with noise."""
    results = [reproduction.flight_results[f"hexjet-doublet.{c}"] for c in ("baseline", "smith")]
    a, b = (result.metrics for result in results)
    less, faster = numbers.value("hexjet.less_overshoot"), numbers.value("hexjet.faster_settling")
    rmse, most = numbers.value("hexjet-doublet.smith.rmse"), numbers.value("hexjet-doublet.smith.max")
    return table(
        ("roll doublet", "baseline", "Smith predictor", "paper, Smith predictor"),
        [
            ("outcome", *map(_describe_outcome, results), "stable; baseline not"),
            ("overshoot", *(_format_overshoot(m) for m in (a, b)), f"{less:g} % below the baseline's"),
            ("settling, to 5 %", *(_format_settling(m) for m in (a, b)), f"{faster:g} % faster than the baseline's"),
            ("RMSE", *(f"{m.rmse:.2g} rad" for m in (a, b)), f"{rmse:g} rad"),
            ("maximum error", *(f"{m.max:.3g} rad" for m in (a, b)), f"{most:.4f} rad"),
        ],
        left=4,
    )


def _describe_outcome(result: Result) -> str:
    experiment = result.experiment
    seconds = len(result.time) * experiment.step
    if seconds < experiment.record - 0.5 * experiment.step:
        return f"lost at {seconds:.1f} s, swinging up"
    return "settles hold_in_both ways, ends level" if result.metrics.stable else "does not settle"


def _format_overshoot(metrics: Metrics) -> str:
    return "-" if not metrics.stable or metrics.overshoot_percent is None else f"{metrics.overshoot_percent:.0f} %"


def _format_settling(metrics: Metrics) -> str:
    return "never" if not metrics.stable or metrics.settling_s is None else f"{metrics.settling_s:.1f} s"


def _list_held_claims(reproduction: Reproduction) -> str:
    """Return the list of the paper's main claims, with the numbers of hold_in_both fidelities."""
    claims = {row.key: row for row in reproduction.claims}
    rows = {row.key: row for row in reproduction.rows}

    def hold_in_both(*keys: str) -> bool:
        return all(_is_held(judged) for key in keys for judged in (claims[key].linear, claims[key].flight))

    def note_if_not_both(text: str, *keys: str) -> str:
        return text if hold_in_both(*keys) else f"{text} (not in hold_in_both fidelities)"

    computed = reproduction.linear.evidence.margins["smith"].phase_margin or 0.0
    measured = reproduction.flight_evidence.margins["smith"].phase_margin or 0.0
    less, faster = rows["hexjet.less_overshoot"], rows["hexjet.faster_settling"]
    delay = next(condition.values for condition in reproduction.linear.conditions if condition.key == "baseline-delay")
    lines = [
        note_if_not_both(
            "Without a predictor the quadrotor is stable with 5 samples and not with 10; with Smith's it is stable with 5, "
            f"10 and 25. Its rate loop alone loses stability with {delay['rate_loop']:.0f}, with the attitude loop "
            f"closed round it with {delay['with_attitude_loop']:.0f}.",
            "baseline-5", "baseline-10", "smith-25",
        ),
        note_if_not_both(
            "Smith's predictor holds the Hex-Jet through its doublet at gains at which the baseline is lost. The gains are "
            "not printed: we chose them so that the baseline is lost.",
            "hexjet-baseline", "hexjet-smith",
        ),
        f"Where the baseline just settles, Smith overshoots {less.flight:.0f} % less and settles {faster.flight:.0f} % "
        f"faster in flight (paper {less.paper:g} % and {faster.paper:g} %). This is the fit itself: on the linear plant "
        f"two gains were fitted to these two numbers ({less.linear:.0f} % and {faster.linear:.0f} %).",
        note_if_not_both("Smith rejects disturbances best with 10 samples.", "disturbance-smith-10"),
        note_if_not_both("Predictors raise the phase margin, Smith's most: ", "phase-up", "phase-smith")
        + f"{computed:.0f}° computed, {measured:.0f}° measured in flight, "
        f"{numbers.value('frequency.smith.phase_margin'):.1f}° in the paper.",
    ]  # fmt: skip
    return "".join(f"- {line}\n" for line in lines)


def _is_held(judged: Judgement | None) -> bool:
    return judged is not None and judged.verdict in ("holds", "by construction")


def _make_differences_table(reproduction: Reproduction) -> str:
    """Return the table of what does not follow from the printed model, with our numbers."""
    linear, flight = reproduction.linear.evidence, reproduction.flight_evidence
    margins = linear.margins

    def format_growth(new: str, old: str, quantity: str, evidence: Evidence = flight) -> str:
        metrics = evidence.metrics
        return f"{100.0 * (getattr(metrics[new], quantity) / getattr(metrics[old], quantity) - 1.0):+.0f} %"

    pair, unseen = (
        ("disturbance-10.smith", "disturbance-5.smith"),
        ("disturbance-10-unseen.smith", "disturbance-5-unseen.smith"),
    )
    sign = next(condition.values for condition in reproduction.linear.conditions if condition.key == "payload-sign")
    amplitude, tau = numbers.value("step.amplitude"), numbers.value("step.time_constant")
    least = radians(amplitude) * (3.0 * tau / numbers.value("step.record")) ** 0.5
    loaded = flight.metrics["step-10-payload.state"].stable
    late = [format_growth("step-25.smith", "step-5.smith", "rmse", evidence) for evidence in (linear, flight)]
    rows = [
        (
            f"RMSE of {numbers.value('step-5.baseline.rmse'):.3f} rad for {amplitude:g}° either way with a time constant of "
            f"{tau:g} s",
            f"An exponential alone would have {least:.3f} rad. All six printed errors follow within 15 % if the doublet is "
            f"{amplitude:g}° from peak to peak",
        ),
        (
            f"the cut-off falls with a predictor, most with Smith ({numbers.value('frequency.smith.cutoff'):g} Hz)",
            "With an exact model Smith's open loop has the gain of the baseline's at every frequency, so the same cut-off. "
            "No error of gain and delay gives the three printed numbers together",
        ),
        (
            f"gain margin of Smith below the baseline's ({numbers.value('frequency.smith.gain_margin'):g} dB, "
            f"{numbers.value('frequency.baseline.gain_margin'):g} dB)",
            f"Above: {margins['smith'].gain_margin:.1f} dB and {margins['baseline'].gain_margin:.1f} dB. The phase that the "
            "predictor returns moves the crossing to a frequency where the gain is lower",
        ),
        (
            "the state predictor fails with 25 samples",
            "With the matrices as printed: yes, at any observer bandwidth. With the transfer function realised: no",
        ),
        (
            "with payload and 10 samples the state predictor becomes unstable",
            f"On the linear plant only because the payload's effect is fitted: its gain is raised by "
            f"{100.0 * (sign['fitted_gain'] - 1.0):.0f} %. The same mass in six degrees of freedom lowers it by "
            f"{100.0 * (1.0 - sign['flown_gain']):.0f} %, the opposite sign; there the state predictor is "
            f"{'stable' if loaded else 'unstable'}",
        ),
        (
            f"with payload the state predictor's error grows by {sign['paper_growth_percent']:.1f} %",
            f"By {format_growth('disturbance-5-payload.state', 'disturbance-5.state', 'rmse', linear)} on the linear plant at the "
            f"fitted gain, {format_growth('disturbance-5-payload.state', 'disturbance-5.state', 'rmse')} in flight",
        ),
        (
            "from 5 to 10 samples Smith's errors under a disturbance grow by 2.9 % and 0.2 %",
            f"By {format_growth(*pair, 'rmse')} and {format_growth(*pair, 'max')} in flight if the disturbance enters before the "
            f"predictor's tap, so that the predictor is told of it; by {format_growth(*unseen, 'rmse')} and "
            f"{format_growth(*unseen, 'max')} if it is not",
        ),
        (
            f"Smith's tracking error grows by {numbers.value('step-25.smith.increase'):g} % from 5 to 25 samples",
            f"By {late[0]} on the linear plant and {late[1]} in flight. Waiting 20 samples longer costs that much at the "
            "printed amplitude, whatever the controller",
        ),
        (
            f"a largest error of {numbers.value('hexjet-doublet.smith.max'):.4f} rad in the Hex-Jet's doublet",
            f"{flight.metrics['hexjet-doublet.smith'].max:.3f} rad: the height of the middle step, which any loop has that "
            "settled before it. It tests nothing",
        ),
    ]  # fmt: skip
    return table(("the paper", "ours"), rows, left=2)


def _make_turbojet_table(reproduction: Reproduction) -> str:
    """Return the table of each controller's fastest attitude loop with fans and with turbojets."""
    reach = {(design.engine, design.controller): design for design in reproduction.linear.turbojet}
    designs = {design.controller: design for design in reproduction.turbojet}

    def format_bandwidth(engine: str, controller: str) -> str:
        design = reach.get((engine, controller))
        return "-" if design is None or design.bandwidth is None else f"{design.bandwidth:.2f} Hz"

    def format_percent(value: float | None) -> str:
        return "-" if value is None else f"{value:.0f} %"

    rows = []
    for controller in dict.fromkeys(design.controller for design in reproduction.linear.turbojet):
        flight = designs.get(controller)
        linear = reach.get(("turbojet", controller))
        settles = "-" if flight is None else "never" if flight.settling_s is None else f"{flight.settling_s:.1f} s"
        rows.append(
            (
                NAMES[controller],
                format_bandwidth("edf-as-flown", controller),
                format_bandwidth("turbojet", controller),
                format_percent(linear.overshoot_percent if linear else None),
                format_percent(flight.overshoot_percent if flight else None),
                settles,
            )
        )
    head = ("controller", "fans with delay", "turbojet", "overshoot, linear", "overshoot, flown", "settles, flown")
    times = {
        controller: there.noise_gain / here.noise_gain
        for (engine, controller), there in reach.items()
        if engine == "turbojet" and there.noise_gain
        for here in [reach.get(("edf-as-flown", controller))]
        if here is not None and here.noise_gain
    }
    note = (
        f"\nThe price is noise: the lag has to be undone by the controller, and the gyro's noise reaches the throttle "
        f"{min(times.values()):.1f} to {max(times.values()):.1f} times stronger than with the fans, "
        f"{times['smith']:.1f} times with Smith's.\n"
        if "smith" in times
        else ""
    )
    return table(head, rows) + note

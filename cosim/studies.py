"""What studies of another kind are made of: draws, flights and their rows, workers, folders, claims, pages.

``cosim.campaign`` has what a program calls; this is for tools that look for something among flights.
"""

from cosim.campaign.analysis.cards import referee_cards
from cosim.campaign.analysis.claim import ClaimResult, format_bound, judge_claim
from cosim.campaign.analysis.margin import requirement_margins, row_margin
from cosim.campaign.analysis.page import key_rows, write_campaign_report
from cosim.campaign.analysis.statistics import LEVEL, proportion
from cosim.campaign.analysis.summary import SUCCESS, rank_keys, with_referee
from cosim.campaign.analysis.table import FlightTable, describe_range, read_flight_table
from cosim.campaign.analysis.worst_cases import eccentricity, write_flight
from cosim.campaign.folder import ASKED, CASES, REFEREE, STUDY, is_campaign
from cosim.campaign.run import (
    Progress,
    choose_workers,
    count_processors,
    fly_again,
    open_workers,
    refuse_changes,
    run_campaign,
    run_sampler,
)
from cosim.campaign.store import Campaign, Tally, open_campaign
from cosim.campaign.study.distributions import Vary, first_repeated, parse_number, parse_vary
from cosim.campaign.study.draws import flight_seed
from cosim.campaign.study.engine_draw import ENGINE, EngineDraw, default_draw, engine_draw
from cosim.campaign.study.key import Key, Value
from cosim.campaign.study.keys import all_keys, with_values
from cosim.campaign.study.model_notes import design_warnings, nominal_model_notes
from cosim.campaign.study.normal_space import MAX_SIGMA, NormalSpace, draw_seed
from cosim.campaign.study.options import NothingVariesError, open_study
from cosim.campaign.study.plan import Flight, flight_of, only_controller, scenario_of
from cosim.campaign.study.sequential import MAX_TESTED, Decision, Verdict, default_runs, parse_claim
from cosim.campaign.study.study import Study, find_study, flatten_settings, study_code, study_names
from cosim.campaign.study.values import absolute_support, check_vary, levels, quantum, whole_bounds
from cosim.campaign.workers.flight_row import (
    MARGIN_OF,
    NOT_FLOWN,
    Chunk,
    Row,
    describe_not_flown,
    failed_row,
    fly_one,
    outcome_row,
    worker_name,
)
from cosim.campaign.workers.protocol import Workers
from cosim.results.limits import LIMITED
from cosim.results.metrics import check_expectations, metric_names
from cosim.results.wording import metric

"""Analysis of a dataset: counts, leakage between its splits, and shift between them.

Card, report and validation read its statistics, and the companions and front matter of datasets.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from pipeline.inspection import front_matter as front_matter
    from pipeline.inspection.analyse import as_text as as_text
    from pipeline.inspection.analyse import statistics_of as statistics_of
    from pipeline.inspection.front_matter import Companion as Companion
    from pipeline.inspection.leakage import find_leakage as find_leakage
    from pipeline.inspection.leakage import id_of as id_of
    from pipeline.inspection.near_twins import Neighbourhood as Neighbourhood
    from pipeline.inspection.shift import holm as holm
    from pipeline.inspection.statistics import DatasetStatistics as DatasetStatistics
    from pipeline.inspection.statistics import Route as Route
    from pipeline.inspection.statistics import SplitCounts as SplitCounts
    from pipeline.inspection.statistics import routes_of as routes_of
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "analyse": ("as_text", "statistics_of"),
            "front_matter": ("Companion",),
            "leakage": ("find_leakage", "id_of"),
            "near_twins": ("Neighbourhood",),
            "shift": ("holm",),
            "statistics": ("DatasetStatistics", "Route", "SplitCounts", "routes_of"),
        },
    )

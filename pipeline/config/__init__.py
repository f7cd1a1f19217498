"""What stages need to declare their options: types, checks, one-line errors, shared options.

A stage is given a `Job`, plain frozen objects in which no option is invalid.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from pipeline.config.declaration import ConfigError as ConfigError
    from pipeline.config.declaration import as_typed as as_typed
    from pipeline.config.declaration import check as check
    from pipeline.config.declaration import check_options as check_options
    from pipeline.config.declaration import frozen as frozen
    from pipeline.config.declaration import literal as literal
    from pipeline.config.declaration import option as option
    from pipeline.config.options import ExportOptions as ExportOptions
    from pipeline.config.options import ResultFolderOptions as ResultFolderOptions
    from pipeline.config.options import SourceOptions as SourceOptions
    from pipeline.config.options import TrainingOptions as TrainingOptions
    from pipeline.config.options import WorkOptions as WorkOptions
    from pipeline.config.stage import Job as Job
    from pipeline.config.stage import Stage as Stage
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "declaration": (
                "ConfigError",
                "as_typed",
                "check",
                "check_options",
                "frozen",
                "literal",
                "option",
            ),
            "options": (
                "ExportOptions",
                "ResultFolderOptions",
                "SourceOptions",
                "TrainingOptions",
                "WorkOptions",
            ),
            "stage": ("Job", "Stage"),
        },
    )

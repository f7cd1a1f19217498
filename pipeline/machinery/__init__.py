"""Infrastructure shared by the stages: processes, folders that become complete, the console.

It knows no stage.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from pipeline.machinery.artifact import Ownership as Ownership
    from pipeline.machinery.artifact import Sums as Sums
    from pipeline.machinery.artifact import held as held
    from pipeline.machinery.artifact import leave as leave
    from pipeline.machinery.artifact import produced as produced
    from pipeline.machinery.artifact import within as within
    from pipeline.machinery.console import progress as progress
    from pipeline.machinery.console import say as say
    from pipeline.machinery.console import tracked as tracked
    from pipeline.machinery.executor import cluster as cluster
    from pipeline.machinery.executor import end_with_parent as end_with_parent
    from pipeline.machinery.executor import ordered_map as ordered_map
    from pipeline.machinery.markdown import count as count
    from pipeline.machinery.markdown import plain as plain
    from pipeline.machinery.markdown import table as table
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "artifact": ("Ownership", "Sums", "held", "leave", "produced", "within"),
            "console": ("progress", "say", "tracked"),
            "executor": ("cluster", "end_with_parent", "ordered_map"),
            "markdown": ("count", "plain", "table"),
        },
    )

"""Show the arguments of the loaders, which a decorator gives them, in the reference of the site.

The reference is made from the source, where `asked_by` stands above a function of a request.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

import griffe


class LoaderSignatures(griffe.Extension):
    """Gives decorated functions the arguments that they have when they are called."""

    def on_function(self, *, func: griffe.Function, **_: Any) -> None:
        """Replace the parameters of a function with `asked_by`."""
        if not any(str(each.value).startswith("asked_by(") for each in func.decorators):
            return
        called = getattr(import_module(func.module.path), func.name)
        func.parameters = griffe.Parameters(
            *(
                griffe.Parameter(
                    each.name,
                    annotation=each.annotation,
                    kind=griffe.ParameterKind[each.kind.name.lower()],
                    default=None if each.default is each.empty else repr(each.default),
                )
                for each in inspect.signature(called).parameters.values()
            )
        )

"""The declaration of what stages leave beside datasets."""

COMPANIONS = ("pipeline.questions.companion",)
"""The modules that declare a `COMPANION`; see `pipeline.inspection.companions`."""

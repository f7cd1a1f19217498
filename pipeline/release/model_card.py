"""The card of a policy, a pure function of its evaluation and of its dataset."""

from __future__ import annotations

from dataclasses import dataclass

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.results import Results
from labyrinth_core.policies.spec import MapperSpec, PlannerSpec, PolicySpec
from pipeline.machinery.markdown import count, table
from pipeline.release.provenance import code
from pipeline.release.texts import citation, fill, paragraph


@dataclass(frozen=True)
class Trained:
    """A policy that is published, and what is known of it."""

    model: str
    """The id on the Hub, such as `user/planner-5x5`."""
    version: str
    spec: PolicySpec
    weights: int
    """The number of its weights."""
    dataset: str
    """The id on the Hub of the dataset that it was trained on."""
    revision: str
    """The revision of the dataset."""
    manifest: Manifest
    results: Results
    """What it achieves on that dataset."""
    run: TrainedRun
    """The run that made it."""

    @property
    def config(self) -> str:
        """The config of the dataset."""
        return self.manifest.config.name


def text(trained: Trained) -> str:
    """Return the whole README.md."""
    figures = trained.results.splits["test"].figures()
    low, high = (f"{100 * bound:.0f}" for bound in figures["sr_interval"])
    size = trained.spec.image_size
    shown = ', observation="vector"' if trained.spec.observation == "vector" else ""
    form = "a function from a batch of observations to the scores of the four actions"
    if isinstance(trained.spec.own, MapperSpec):
        shown = f", image_size={size}"
        form = "an object with `reset(count)` and `act(observations)`, which returns actions"
    return fill(
        "model.md",
        dataset=trained.dataset,
        method=trained.run.method,
        config=trained.config,
        sees="vectors" if size is None else f"pictures of {size} x {size} pixels",
        solved=f"{figures['sr']:.1%}",
        low=low,
        high=high,
        labyrinths=f"{figures['labyrinths']:,}",
        model=trained.model,
        version=trained.version,
        revision=trained.revision,
        shown=shown,
        form=form,
        weights=f"{trained.weights:,}",
        training=_training(trained),
        results=_results(trained),
        limits="\n".join(f"- {limit}" for limit in _limits(trained)),
        code=code(),
        citation=citation(),
    )


def _training(trained: Trained) -> str:
    run, training = trained.run, trained.run.training
    asked = run.train_labyrinths
    held = sum(shard.labyrinths for shard in trained.manifest.of("train"))
    labyrinths = count(held if asked is None else asked, "labyrinth")
    of = "" if asked is None else f", the first of {held:,}"
    rows = [
        ("dataset", f"`{trained.config}` of `{trained.dataset}`, revision `{trained.revision}`"),
        ("its fingerprint", f"`{run.fingerprint}`"),
        ("learnt from", f"{labyrinths} of `train`{of}"),
        ("method", f"`{run.method}`, encoder `{run.encoder}`, seed {run.seed}"),
        ("settings", ", ".join(f"`{name}={value}`" for name, value in run.settings.items())),
        (
            "budget",
            f"{count(training['epochs'], 'epoch')}, {training['seconds']:.0f} seconds on "
            f"{training['computed']['device']}",
        ),
        (
            "chosen",
            f"the weights after epoch {training['selected']['epoch']}, by the success rate on "
            "`validation`",
        ),
    ]
    return table(("what", "value"), rows, "ll")


def _results(trained: Trained) -> str:
    rows = []
    for split, scores in trained.results.splits.items():
        figures = scores.figures()
        low, high = figures["sr_interval"]
        efficiency = figures["path_efficiency"]
        chance = trained.results.baselines["random"].get(split)
        rows.append(
            (
                f"`{split}`",
                SPLITS[split].meaning,
                f"{figures['labyrinths']:,}",
                f"{figures['sr']:.1%}",
                f"{100 * low:.0f}-{100 * high:.0f}",
                f"{figures['aer']:.2f} ± {figures['aer_std']:.2f}",
                "-" if efficiency is None else f"{efficiency:.1%}",
                "-" if chance is None else f"{chance['sr']:.1%}",
            )
        )
    heading = ("split", "holds", "labyrinths", "SR", "95%", "AER", "efficiency", "random")
    return table(heading, rows, "ll" + "r" * 6)


def _limits(trained: Trained) -> list[str]:
    """Return the points on what the results do not say."""
    mapper = isinstance(trained.spec.own, MapperSpec)
    names = ["one_seed", "chosen", "plans_once" if mapper else "no_memory"]
    names += ["pictures"] * (trained.spec.observation == "image")
    names += ["knowledge"] * isinstance(trained.spec.own, PlannerSpec)
    return [paragraph(f"policy_{name}") for name in names]

"""A language model in labyrinths, by inspect-ai: text or picture in, a route out, scored exactly.

    labyrinth-datasets size=5
    inspect eval examples/language_model.py -T picture=true --model openai/gpt-5

Needs: pip install labyrinth-datasets inspect-ai
"""

import base64
import re

from inspect_ai import Task, task
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessageUser, ContentImage, ContentText
from inspect_ai.scorer import CORRECT, INCORRECT, Score, Scorer, Target, accuracy, scorer, stderr
from inspect_ai.solver import TaskState, generate

from labyrinth_core import Action, Labyrinth, dump, load_arrays, parse
from labyrinth_core.language.drawing import describe
from labyrinth_core.pictures.renderer import render_png
from labyrinth_core.world.dynamics import initial, is_terminal, step_limit, transition

RULES = """Lead the agent (@, green) to the goal (E, blue). A door (D, brown) opens to an agent that
has been on the key (K, yellow). Ice (I, light blue) ends the attempt. Answer with the moves alone,
such as: up right right down left"""


def sample_of(labyrinth: Labyrinth, picture: bool) -> Sample:
    """Return a labyrinth as a question; its target is the labyrinth itself, for the scorer."""
    text = describe(labyrinth, initial(labyrinth))
    if not picture:
        return Sample(input=f"{RULES}\n\n{text}", target=dump(labyrinth))
    png = base64.b64encode(render_png(labyrinth, initial(labyrinth))).decode()
    shown = [ContentText(text=RULES), ContentImage(image=f"data:image/png;base64,{png}")]
    return Sample(input=[ChatMessageUser(content=shown)], target=dump(labyrinth))


@scorer(metrics=[accuracy(), stderr()])
def reaches_the_goal() -> Scorer:
    """Walk the answer's moves, by the rules of the environment, and see where they end."""

    async def score(state: TaskState, target: Target) -> Score:
        labyrinth, words = parse(target.text), state.output.completion.lower()
        at, moves = initial(labyrinth), re.findall(r"\b(?:up|right|down|left)\b", words)
        for move in moves[: step_limit(labyrinth)]:
            if not is_terminal(labyrinth, at):
                at = transition(labyrinth, at, Action[move.upper()])
        solved = at.agent == labyrinth.goal
        return Score(value=CORRECT if solved else INCORRECT, answer=" ".join(moves))

    return score


@task
def labyrinths(folder="data/labyrinth", config="5x5", split="test", picture=False) -> Task:
    """Ask for a route through each labyrinth of a split."""
    arrays = load_arrays(folder, config, split, observation="vector")
    samples = [sample_of(labyrinth, picture) for labyrinth in arrays.labyrinths]
    return Task(samples, solver=generate(), scorer=reaches_the_goal())

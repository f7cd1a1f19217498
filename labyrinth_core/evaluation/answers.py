"""Show a policy observations, call it, and read its answers: actions or scores.

Answers are arrays of NumPy, PyTorch or JAX. Only NumPy is imported: a policy can be a PyTorch
module only if PyTorch has already been imported, and arrays of the other libraries convert
themselves to NumPy's.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.errors import one_line
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, PICTURE_SIZE
from labyrinth_core.world import Action, Task

if TYPE_CHECKING:
    from labyrinth_core.pictures import ObservationSpec

Policy = Callable[[Any], Any]
"""Maps B observations to B actions, or to scores of the four actions, shape (B, 4).

Observations are uint8 (B, size, size, 3), int32 vectors (B, length), or a list of B texts.
"""

ACTIONS = len(Action)


class PolicyError(ValueError):
    """A policy cannot see the labyrinths, or answers with anything but actions.

    If the policy raised an error, that is the cause.
    """

    @classmethod
    def calling(cls, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call a part of a policy and return its result.

        Raises:
            PolicyError: The call raises an error, or ends the program.
        """
        try:
            return call(*arguments)
        except PolicyError:
            raise
        except (Exception, SystemExit) as error:  # Foreign code may raise anything.
            shown = "" if not arguments else f" when given {_described(arguments[0])}"
            reason = f"{type(error).__name__}: {one_line(error):.300}"
            raise cls(f"the policy raised {reason}{shown}") from error


def fitted(
    policy: Any,
    height: int,
    width: int,
    task: Task,
    *,
    observation: str | None = None,
    image_size: int | None = None,
) -> tuple[Any, ObservationSpec]:
    """Return a policy adapted to labyrinths of one size and task, and its observation there.

    A policy may declare by attributes what it has to be shown: `observation`; `image_size`, a
    number of pixels or a function of height and width; and `resize`, as for `load_arrays`. A policy
    that depends on the labyrinths has `for_labyrinths(height, width, task)`, which returns the
    policy for them, or raises a PolicyError if they cannot be shown to it.

    Args:
        policy: Any policy that `evaluate` accepts.
        height: Rows of cells.
        width: Columns of cells.
        task: The task of the labyrinths.
        observation: The caller's choice; None for the policy's own, or "image".
        image_size: The caller's choice; None for the policy's own, or 64.

    Raises:
        ValueError: An argument has a value that is not allowed.
        PolicyError: The policy cannot be shown these labyrinths, or not with this observation.
    """

    def stated(name: str) -> Any:
        return (
            None
            if isinstance(policy, type)
            else PolicyError.calling(lambda: getattr(policy, name, None))
        )

    adapt = stated("for_labyrinths")
    if adapt is not None:
        policy = PolicyError.calling(partial(adapt, height, width, task))
    kind, pixels, resize = stated("observation"), stated("image_size"), stated("resize")
    if isinstance(kind, str):  # Other policies may use this name for something else.
        if observation not in (None, kind):
            raise PolicyError(f"the policy needs observation={kind}, but is shown {observation}")
        observation = kind
    observation = "image" if observation is None else observation
    if observation == "image" and pixels is not None:
        needed = _needed_size(pixels, height, width)
        if image_size not in (None, needed):
            raise PolicyError(
                f"the policy needs image_size={needed} at {height}x{width}, but is shown "
                f"image_size={image_size}"
            )
        image_size = needed
    size = DEFAULT_IMAGE_SIZE if image_size is None else image_size
    resize = resize if isinstance(resize, str) else "area"
    from labyrinth_core.pictures import ObservationSpec

    return policy, ObservationSpec(observation, size, draw=True, resize=resize)


def _needed_size(pixels: Any, height: int, width: int) -> int:
    """Return the pixels on each side that a policy's `image_size` requires."""
    size = PolicyError.calling(partial(pixels, height, width)) if callable(pixels) else pixels
    try:
        return whole("image_size", size, 1, PICTURE_SIZE)
    except ValueError as error:
        raise PolicyError(
            f"the policy asks for image_size={size!r:.60} at {height}x{width}: a whole number of "
            f"pixels from 1 to {PICTURE_SIZE} is allowed"
        ) from error


def decide(
    policy: Policy, observations: NDArray[Any], rows: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """Return the actions of a policy; of equally high scores the first counts.

    Args:
        policy: The policy to call.
        observations: The B observations that it is shown.
        rows: The N answers that count; None for all. The others need not be actions.

    Returns:
        Actions from 0 to 3, shape (N,).

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    shown = observations.tolist() if observations.dtype.kind == "U" else observations
    answered = PolicyError.calling(policy, shown)
    answer = _as_array(answered)
    count = len(observations)
    scored = answer.shape == (count, ACTIONS) and answer.dtype.kind in "iuf"
    if not scored and (answer.shape != (count,) or answer.dtype.kind not in "iu"):
        raise PolicyError(
            f"the policy answered {_described(answered if answer.dtype == object else answer)} to "
            f"{count} observations: give actions, whole numbers of shape ({count},), or scores "
            f"of shape ({count}, {ACTIONS})"
        )
    counting = answer if rows is None else answer[rows]
    if scored:
        if np.isnan(counting).any():
            raise PolicyError("the policy answered nan as the score of an action: give numbers")
        best: NDArray[np.int64] = counting.argmax(axis=1)
        return best
    wrong = counting[(counting < 0) | (counting >= ACTIONS)]
    if wrong.size:
        raise PolicyError(
            f"the policy answered action {wrong[0]}: give 0 up, 1 right, 2 down or 3 left"
        )
    return counting.astype(np.int64)


def memory_of(remembered: Callable[[], Any], count: int) -> NDArray[Any]:
    """Return what a policy remembers of `count` episodes, a row for each.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but such an array.
    """
    answered = PolicyError.calling(remembered)
    held = _as_array(answered, "remembered()")
    if held.dtype == object or held.ndim == 0 or len(held) != count:
        raise PolicyError(
            f"remembered() answered {_described(answered if held.dtype == object else held)}: give "
            f"an array with a row for each of the {count} episodes"
        )
    return held


def _as_array(answer: Any, who: str = "the policy") -> NDArray[Any]:
    if np.ma.is_masked(answer):
        raise PolicyError(f"{who} answered a masked array: give -inf where scores are masked")
    try:
        if hasattr(answer, "detach"):  # A tensor of PyTorch, on any device.
            answer = answer.detach().cpu()
            # NumPy has no bfloat16; float64 holds every value of a smaller type exactly.
            answer = answer.double() if answer.is_floating_point() else answer
        array = np.asarray(answer)
        # JAX's bfloat16 is not a NumPy type.
        return array.astype(np.float64) if array.dtype.kind == "V" else array
    except Exception as error:  # The answer may be of any class.
        name = type(answer).__name__
        raise PolicyError(f"{who} answered {name}, which is not an array: give one") from error


def _described(value: Any) -> str:
    """Return a short description of a value's type."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    texts = isinstance(value, list) and all(isinstance(each, str) for each in value)
    return f"{len(value)} texts" if texts else type(value).__name__


def _evaluating(module: Any) -> Policy:
    """Return a PyTorch module as a function.

    The module is called with tensors on its own device, in evaluation mode and without gradients;
    afterwards its modes are restored.
    """
    torch = sys.modules["torch"]

    def forward(observations: Any) -> Any:
        modes = [(each, each.training) for each in module.modules()]
        module.eval()
        try:
            if isinstance(observations, np.ndarray):
                weight = next(module.parameters(), None)
                device = None if weight is None else weight.device
                observations = torch.as_tensor(observations, device=device)
            with torch.no_grad():
                return module(observations)
        finally:
            for each, training in modes:
                each.training = training

    return forward


class Predicting:
    """Adapts a Stable-Baselines3 policy with memory to `reset` and `act`."""

    def __init__(self, policy: Any) -> None:
        self._predict = policy.predict

    def reset(self, count: int) -> None:
        """Begin `count` episodes."""
        self._state, self._starts = None, np.ones(count, np.bool_)

    def act(self, observations: Any) -> Any:
        """Return the actions, shape (B,)."""
        actions, self._state = self._predict(
            observations, state=self._state, episode_start=self._starts, deterministic=True
        )
        self._starts = np.zeros(len(self._starts), np.bool_)
        return actions


def remembers(policy: Any) -> bool:
    """Return whether a policy has `reset` and `act`."""
    return hasattr(policy, "reset") and hasattr(policy, "act")


def in_our_form(policy: Any) -> Any:
    """Adapt a policy of PyTorch or Stable-Baselines3; return any other unchanged.

    The `predict(observation, state, episode_start, deterministic)` of Stable-Baselines3 returns
    actions and a state. If the state for a sample observation is None, the policy has no memory;
    without an observation space to sample from, it is stepped, which is right in either case. Such
    policies may also be PyTorch modules, but calling them does not return actions.

    Raises:
        PolicyError: It has LeRobot's interface, but lacks its processors.
    """
    torch = sys.modules.get("torch")
    is_module = torch is not None and isinstance(policy, torch.nn.Module)
    if remembers(policy) or (callable(policy) and not is_module):
        return policy
    if hasattr(policy, "reset") and hasattr(policy, "select_action"):
        raise PolicyError(
            "policy: give a LeRobot policy with its processors, as examples/lerobot_policy.py does"
        )
    if not (hasattr(policy, "predict") and takes(policy.predict, "deterministic")):
        return _evaluating(policy) if is_module else policy
    space = getattr(policy, "observation_space", None)
    if space is None or policy.predict(space.sample(), deterministic=True)[1] is not None:
        return Predicting(policy)
    return lambda observations: policy.predict(observations, deterministic=True)[0]


def takes(function: Callable[..., Any], argument: str) -> bool:
    """Return whether a function has an argument of this name."""
    try:
        return argument in inspect.signature(function).parameters
    except Exception:  # A function that is not written in Python, or hides its signature.
        return False

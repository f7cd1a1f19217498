"""`certify` on environments whose levels are known, and on some that deceive."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from functools import partial

import gymnasium
import numpy as np
import pytest
from support import deceiving
from support.deceiving import (
    DECEIVERS,
    Corridor,
    DictOrder,
    FailsAtTimes,
    HashSeed,
    Late,
    Unreadable,
)

from labyrinth_core import certify
from labyrinth_core.benchmarks import CertifyError, certification, repeats

quick = partial(certify, probes=2, steps=16, progress=False)


@pytest.fixture
def one_interpreter(monkeypatch):
    """Leave out new interpreters, each of which takes a second."""
    monkeypatch.setattr(repeats, "_new_interpreters", lambda *_: ())


@pytest.mark.slow
@pytest.mark.parametrize("deceiver", DECEIVERS, ids=lambda each: each.__name__)
def test_an_environment_that_deceives_gets_the_right_word_and_no_wrong_share(deceiver, request):
    if deceiver not in (HashSeed, DictOrder):  # Only these ask what a new interpreter changes.
        request.getfixturevalue("one_interpreter")
    found = quick(deceiver, range(6), range(100, 160))
    if DECEIVERS[deceiver]:
        assert found.first is found.probes is found.levels is None
        assert all(reason.startswith(DECEIVERS[deceiver]) for reason in found.reasons.values())
        assert DECEIVERS[deceiver] in str(found)
        assert "cannot be given" in found.sentence
        assert ("in new interpreters" in found.checked) == (deceiver is HashSeed)
        with pytest.raises(CertifyError, match="no level can be told from another"):
            found.disjoint()
        return
    assert found.reasons == {}
    of = 60 if deceiver is not FailsAtTimes else 58
    known = sum(seed % 10 < 6 for seed in found.test.seeds)
    for share in (found.first, found.probes):
        assert (share.count, share.of) == (known, of)
    assert found.levels.seen == 10
    assert "nothing differs" in found.checked


@pytest.mark.usefixtures("one_interpreter")
def test_a_seed_at_which_the_environment_fails_is_named_and_the_rest_goes_on():
    found = quick(FailsAtTimes, range(100), range(100, 160))
    assert found.train.failed == ((7, "ValueError: no level 7"), (57, "ValueError: no level 57"))
    assert len(found.train.seeds) == 98
    assert "train seed 57: ValueError: no level 57" in str(found)
    with pytest.raises(CertifyError, match=r"fails at all test seeds; seed 7: ValueError"):
        quick(FailsAtTimes, [0, 1], [7])
    with pytest.raises(CertifyError, match=r"fails at each of 2 seeds; seed 7: ValueError"):
        quick(FailsAtTimes, [7], [57])


@pytest.mark.usefixtures("one_interpreter")
def test_what_differs_is_named_by_seed_step_and_part():
    reasons = quick(deceiving.Clock, range(9), range(9, 20)).reasons
    assert (
        f"{repeats.AGAIN}, seed 0 differs at step 0 of probe 2, observation['time']: "
        in reasons["first"]
    )
    steps = quick(deceiving.StepsDiffer, range(9), range(9, 20))
    assert steps.first.count == 10 + (19 % 10 < 9) - 1
    assert steps.probes is None
    assert "step 1 of probe 1, observation: [0, " in steps.reasons["probes"]
    assert steps.levels.by == "first"
    second = quick(deceiving.SecondType, range(9), range(9, 20))
    assert "observation.dtype: int64, then int32" in second.reasons["first"]

    early = quick(deceiving.LateClock, range(9), range(9, 20))
    assert early.reasons == {}
    late = quick(deceiving.LateClock, range(9), range(9, 20), steps=32)
    assert late.first.count == early.probes.count == 9
    assert late.reasons["probes"].startswith("it reads a clock")
    assert "at step 21 of probe " in late.reasons["probes"]


@pytest.mark.usefixtures("one_interpreter")
def test_an_action_space_that_the_seed_chooses_is_named():
    found = quick(deceiving.SpaceOfSeed, range(6), range(100, 130))
    (note,) = found.notes
    assert note.endswith(
        "differs: Discrete(2) at seed 0, Discrete(3) at seed 1, Discrete(4) at seed 5"
    )
    assert note in found.sentence
    assert "no action 3" in dict(found.train.failed)[0]


@pytest.mark.usefixtures("one_interpreter")
def test_a_level_that_differs_late_is_told_apart_with_more_steps():
    seeds = {"train": range(5), "test": range(5, 10)}
    assert quick(Late, **seeds, steps=64).probes.share == 1
    assert quick(Late, **seeds, steps=101).probes.share == 0


@pytest.mark.usefixtures("one_interpreter")
def test_a_state_tells_levels_apart_that_are_never_seen():
    found = quick(Late, range(5), range(5, 10), state=lambda env: env.level)
    assert (found.first.share, found.probes.share, found.state.share) == (1, 1, 0)
    assert found.levels.by == "state"
    assert found.levels.seen == 10


@pytest.mark.usefixtures("one_interpreter")
def test_a_state_that_leaves_something_out_is_refused():
    found = quick(Corridor, range(5), range(5, 10), state=lambda env: env.position)
    assert found.state is None
    assert found.reasons == {"state": "seeds 0 and 1 have equal states and other episodes"}
    assert found.levels.by == "probes"


@pytest.mark.usefixtures("one_interpreter")
def test_a_seed_that_changes_after_the_check_is_found():
    class Tired(Corridor):
        """Shows other levels from its hundredth reset on."""

        resets = 0

        def level_of(self, seed):
            self.resets += 1
            return seed % 10 + (self.resets > 70)

    reasons = quick(Tired, range(100), range(100, 200)).reasons
    assert reasons.keys() == {"first", "probes"}
    assert reasons["probes"] == "seed 0 gave something else after other episodes"


@pytest.mark.usefixtures("one_interpreter")
def test_one_seed_that_a_second_reset_changes_is_found_wherever_it_is():
    class Fickle(Corridor):
        resets = 0

        def level_of(self, seed):
            self.resets += seed == 14
            return seed % 10 + self.resets % 2

    found = quick(Fickle, range(40), range(40, 80))
    assert found.measures == {}
    text = "seed 14 gave another first observation when reset again"
    assert found.reasons == {"first": text, "probes": text}


@pytest.mark.usefixtures("one_interpreter")
def test_a_fresh_environment_for_each_episode_answers_for_one_that_counts_its_resets():
    found = quick(deceiving.SecondReset, range(5), range(5, 15), fresh=True)
    assert found.reasons == {}
    assert found.probes.count == 5
    assert found.arguments["fresh"]


@pytest.mark.usefixtures("one_interpreter")
def test_the_specification_of_a_nondeterministic_environment_is_read():
    gymnasium.register("Restless-v0", entry_point=Corridor, nondeterministic=True)
    try:
        found = quick("Restless-v0", range(5), range(5, 15))
    finally:
        del gymnasium.registry["Restless-v0"]
    assert found.reasons == {"probes": "its specification says that it is nondeterministic"}
    assert found.first.count == 5


@pytest.mark.slow
def test_levels_that_follow_a_hash_stand_only_where_its_seed_is_fixed(tmp_path):
    program = "from support.deceiving import HashSeed; from labyrinth_core import certify; "
    program += "print(certify(HashSeed, range(9), range(9, 20), probes=1, steps=4))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONHASHSEED": "5", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert f"only with PYTHONHASHSEED=5: {repeats.HASHES}, seed 0 differs at step 0" in done.stdout
    assert "in train" in done.stdout
    assert HashSeed in DECEIVERS


@pytest.mark.slow
def test_a_new_interpreter_that_cannot_make_the_environment_is_told():
    here = object.__new__(type("Here", (), {"__reduce__": lambda _: 1 / 0}))

    def made():
        assert here
        return Corridor()

    found = quick(made, range(5), range(5, 15))
    (note,) = found.notes
    assert note.startswith("not checked in a new interpreter: ")
    assert "cannot be pickled: ZeroDivisionError" in note
    assert note in found.sentence
    assert found.probes.count == 5


@pytest.mark.slow
@pytest.mark.usefixtures("one_interpreter")
def test_two_processes_and_another_chunk_give_the_same_certificate(monkeypatch):
    one = quick(Corridor, range(120), range(120, 240), workers=1)
    two = quick(Corridor, range(120), range(120, 240), workers=2)
    monkeypatch.setattr(certification, "CHUNK", 7)
    other = quick(Corridor, range(120), range(120, 240))
    assert json.dumps(one.to_json()) == json.dumps(two.to_json()) == json.dumps(other.to_json())


@pytest.mark.slow
def test_a_process_that_is_lost_is_told_in_one_line():
    job = certification._Job(None, workers=2, progress=False)
    with pytest.raises(CertifyError, match="workers=2: a process was lost"):
        list(job.map(lambda _: os._exit(1), range(2 * certification.CHUNK), "seeds"))


@pytest.mark.usefixtures("one_interpreter")
def test_a_state_stands_where_nothing_that_is_seen_repeats():
    found = quick(deceiving.Clock, range(5), range(5, 15), state=lambda env: env.level)
    assert found.first is found.probes is None
    assert found.state.count == 5
    assert found.disjoint() == [5, 6, 7, 8, 9]


@pytest.mark.usefixtures("one_interpreter")
def test_the_module_before_an_id_is_imported_and_may_register_it(tmp_path, monkeypatch):
    made = "gymnasium.envs.classic_control:CartPoleEnv"
    registers = f"import gymnasium\ngymnasium.register('Made-v0', '{made}')\n"
    (tmp_path / "made_here.py").write_text(registers, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    found = quick("made_here:Made-v0", range(2), range(2, 4))
    assert found.environment == "made_here:Made-v0"
    assert found.first.of == 2


@pytest.mark.usefixtures("one_interpreter")
def test_the_certificate_of_labyrinths_agrees_with_their_texts():
    name = "labyrinth_core.env:Labyrinth-v0"

    def small():
        return gymnasium.make(name, size=3, observation="vector")

    found = quick(small, range(40), range(1_000, 1_100))
    env = small()
    texts = [
        [env.reset(seed=seed)[1]["labyrinth"] for seed in seeds]
        for seeds in (found.train.seeds, found.test.seeds)
    ]
    known = sum(text in texts[0] for text in texts[1])
    assert found.state.count == found.first.count == found.probes.count == known > 0
    counts = Counter(texts[0] + texts[1])
    assert found.levels.seen == len(counts)
    assert found.levels.once == sum(count == 1 for count in counts.values())
    disjoint = found.disjoint()
    levels = dict(zip(found.test.seeds, texts[1], strict=True))
    assert {levels[seed] for seed in disjoint} == set(texts[1]) - set(texts[0])
    assert len(disjoint) == len({levels[seed] for seed in disjoint})
    assert quick(small, range(40), disjoint).state.count == 0
    assert 0 < found.spread.share < 1


@pytest.mark.usefixtures("one_interpreter")
def test_too_few_disjoint_seeds_are_told_with_the_number_of_levels():
    found = quick(Corridor, range(8), range(8, 40))
    assert found.disjoint() == [8, 9]
    with pytest.raises(CertifyError, match=r"2 of 32 test seeds .* 3 are needed; 40 seeds gave 10"):
        found.disjoint(3)
    with pytest.raises(CertifyError, match=r"0 of 30 .* at least 10"):
        quick(Corridor, range(10), range(10, 40)).disjoint()


@pytest.mark.usefixtures("one_interpreter")
def test_the_curve_counts_what_the_first_seeds_of_train_share():
    found = quick(Corridor, range(8), range(20, 40))
    assert found.curves["probes"] == ((1, 2), (2, 4), (5, 10), (8, 16))


@pytest.mark.usefixtures("one_interpreter")
def test_memory_replays_the_demonstration_of_what_looks_the_same_or_nearest():
    train, test = [1, 5, 9], [1, 2, 3, 9]

    def policy(_):
        return 1

    found = quick(Corridor, train, test, policy=policy).memory
    assert found.train == 3
    assert found.known.count == 2
    # Seed 2 is nearest to 1, whose four steps are too few; so is 3, which is as near to 5.
    assert found.memory.count == 2
    assert found.policy.count == 4
    routes = {5: [1] * 20}
    given = quick(Corridor, train, test, demonstrations=routes).memory
    assert (given.train, given.policy) == (1, None)
    assert given.memory.count == 3  # It ends where the demonstration did.
    with pytest.raises(CertifyError, match="no seed of train has one"):
        quick(Corridor, train, test, demonstrations={2: [1]})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"train": "0:x"}, "train=0:x: give seeds as a range"),
        ({"train": []}, "train=.*0 seeds: give 1 to"),
        ({"test": [-1]}, "test=.*from 0 on"),
        ({"test": None}, "test=None: give seeds"),
        ({"test": range(10**9)}, "test=.*1,000,000,000 seeds: give 1 to 10,000,000"),
        ({"steps": 0}, "steps=0: give a whole number, 1 or more"),
        ({"workers": True}, "workers=True: give a whole number"),
        ({"environment": 3}, "environment=3: give an id of Gymnasium"),
        ({"environment": "Nothing-v0"}, r"Nothing-v0: Environment .Nothing. doesn't exist"),
        ({"environment": "nomodule:Nothing-v0"}, r"No module named 'nomodule'$"),
        ({"environment": "json:Nothing-v0"}, r"Environment `Nothing` doesn't exist\.$"),
        ({"environment": ".json:Nothing-v0"}, r"^\.json:Nothing-v0: .*relative import"),
        ({"environment": lambda: 1 / 0}, r"cannot be made: ZeroDivisionError: division by zero"),
    ],
)
def test_a_mistake_gets_one_line(arguments, message):
    values = {"environment": Corridor, "train": range(3), "test": range(3, 6)} | arguments
    with pytest.raises(CertifyError, match=message) as raised:
        certify(**values)
    assert "\n" not in str(raised.value)


@pytest.mark.usefixtures("one_interpreter")
def test_an_environment_is_found_in_the_module_that_its_id_names():
    name = "labyrinth_core.env:Labyrinth-v0"
    certificate = certify(name, range(3), range(3, 5), steps=2)
    assert certificate.environment == name
    assert certificate.state.of == 2


@pytest.mark.usefixtures("one_interpreter")
def test_an_interface_that_is_not_gymnasiums_is_refused_with_the_way_to_record_it():
    class Old(Corridor):
        def reset(self, **_):
            return np.zeros(2)

    with pytest.raises(CertifyError, match=r"returns ndarray.*examples/record_levels.py"):
        quick(Old, range(3), range(3, 6))


@pytest.mark.usefixtures("one_interpreter")
def test_an_environment_that_exits_or_cannot_be_closed_fails_at_that_seed_alone():
    class Ends(Corridor):
        def level_of(self, seed):
            return seed % 10 if seed != 103 else sys.exit("too hard")

        def close(self):
            raise RuntimeError("closed already")

    found = quick(Ends, range(5), range(100, 130))
    assert found.test.failed == ((103, "SystemExit: too hard"),)


@pytest.mark.usefixtures("one_interpreter")
def test_what_cannot_be_compared_is_a_failure_and_no_share():
    class Opaque(Corridor):
        def look(self):
            return self.seen

    inside = {}
    inside["itself"] = inside
    for seen, message in (
        (object(), "a value of type object cannot be compared"),
        (Unreadable(), r"Unreadable: use detach\(\) first"),
        (inside, "a value contains itself"),
    ):
        Opaque.seen = seen
        with pytest.raises(CertifyError, match=f"fails at each of 6 seeds; seed 0: {message}"):
            quick(Opaque, range(3), range(3, 6))

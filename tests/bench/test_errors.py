"""Messages name types with their article, and help with unknown names, however many there are."""

from __future__ import annotations

from xmarl_bench.errors import a_type, unknown


def test_a_type_has_its_article() -> None:
    assert [a_type(value) for value in (7, OSError(), 1.5, None)] == [
        "an int", "an OSError", "a float", "a NoneType",
    ]  # fmt: skip


def test_the_nearest_choice_comes_first_and_then_all() -> None:
    said = str(unknown("task", "pasage", ["discovery", "passage"], "or a module"))
    assert (
        said
        == "unknown task 'pasage': did you mean 'passage'? Choose one of discovery, passage, or a module."
    )
    assert str(unknown("task", "zzz", ["discovery"])) == "unknown task 'zzz': choose one of discovery."
    assert str(unknown("task", "zzz", [])) == "unknown task 'zzz': none is installed."


def test_of_many_choices_the_nearest_are_listed() -> None:
    names = [f"run-{k}-of-seed-{seed}" for k in range(30) for seed in range(3)]
    said = str(unknown("run", "run-7-of-seed-9", names))
    assert "did you mean 'run-7-of-seed-" in said and said.endswith(" and 87 more.")
    assert len(said) < 200
    assert str(unknown("run", "zzz", names)).endswith(
        "choose one of " + ", ".join(names[:3]) + " and 87 more."
    )

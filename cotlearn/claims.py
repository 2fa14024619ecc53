"""Claims: sentences of the course that a cell asserts on every run."""

#: How a claim that holds is printed; the notebook runner counts lines that begin like this.
HOLDS = "✓ claim: "


def claim(sentence: str, holds: bool) -> None:
    """Prints a claim that holds and stops the notebook at one that does not.

    Args:
        sentence: The claim in words, best with the measured numbers in it.
        holds: Whether the claim is true. Anything with a single truth value: `bool`, a NumPy bool,
            a tensor with one element.

    Raises:
        AssertionError: If the claim does not hold.
        TypeError: If `sentence` is not a string.
        ValueError: If `sentence` is empty, or `holds` has no single truth value.

    Example:
        >>> claim("one plus one is 2", 1 + 1 == 2)
        ✓ claim: one plus one is 2
    """
    if not isinstance(sentence, str):
        raise TypeError(f"sentence must be a string, got {type(sentence).__name__}")
    if not sentence.strip():
        raise ValueError("sentence is empty; expected the claim in words")
    try:
        true = bool(holds)
    except (RuntimeError, ValueError) as error:
        raise ValueError(
            f"holds must be one truth value, got {type(holds).__name__} with several; "
            "reduce it with .all() or .any()"
        ) from error
    if not true:
        raise AssertionError(f"claim does not hold: {sentence}")
    print(HOLDS + " ".join(sentence.split()))


def count_claims(text: str) -> int:
    """Counts the claims that `text`, the printed output of a notebook, says to hold."""
    return sum(line.startswith(HOLDS) for line in text.splitlines())

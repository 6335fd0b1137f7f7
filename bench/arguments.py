"""What several commands make of their arguments."""

from bench.errors import InputError


def assignments(words: list[str]) -> dict[str, str]:
    """`KEY=VALUE` words as a dictionary."""
    for word in words:
        if "=" not in word:
            raise InputError(f"--set {word}: write KEY=VALUE")
    return dict(word.split("=", 1) for word in words)


def usable_device(name: str) -> str:
    """The name of a device of PyTorch that is there."""
    import torch

    try:
        found = torch.device(name)
    except RuntimeError:
        raise InputError(f"--device {name}: no such device; cpu or cuda") from None
    if found.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"--device {name}: PyTorch finds no CUDA device here; use cpu")
    return name

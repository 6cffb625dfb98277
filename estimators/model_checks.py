"""Checks of a model's matrices: shapes and definiteness."""

import operator
from typing import Any

import numpy as np

from estimators.checks import finite_array, frozen, integer, short_repr
from estimators.varying import Schedule


def as_covariance(name: str, value: object) -> np.ndarray:
    """``value`` as a float array ``(..., k, k)``, checked to be symmetric positive semidefinite.

    Raises:
        ValueError: naming the argument and what is wrong with it.
    """
    cov = finite_array(name, value, "...", "k", "k")
    if cov.shape[-1] != cov.shape[-2] or cov.shape[-1] == 0:
        raise ValueError(f"{name} must be a square matrix (..., k, k), got shape {cov.shape}")
    if not cov.size:  # no rows
        return cov
    # Correlations: rounding is a share of standard deviations. What has none correlates with none.
    scale = np.sqrt(np.maximum(cov.diagonal(0, -2, -1), 1e-300))
    with np.errstate(over="ignore"):
        unit = np.clip(cov / scale[..., None] / scale[..., None, :], -1e100, 1e100)
    if (np.abs(unit - unit.mT) > 1e-9).any():
        raise ValueError(f"{name} must be symmetric")
    if np.linalg.eigvalsh(unit).min() < -1e-9:
        lowest = np.linalg.eigvalsh(cov).min()
        raise ValueError(
            f"{name} must be positive semidefinite, its smallest eigenvalue is {lowest:.3g}"
        )
    return 0.5 * cov + 0.5 * cov.mT


def check_matrices(model: Any, shapes: dict[str, str], **options: tuple[str, int | None]) -> None:
    """Check a model's matrices and indices of angles, and set its sizes n, p and q.

    Arrays are kept as read-only copies. If only one of G and H is given, the other is 0.

    Args:
        model: `LinearModel` or `NonlinearModel`.
        shapes: Letters of rows and columns of each matrix, in the order in which sizes are sought;
            m is any size.
        **options: For the letter of a size, the name of the argument that gives it, and its value.

    Raises:
        ValueError: naming the matrix that does not fit.
    """
    for name in shapes:
        value = getattr(model, name)
        if not callable(value) and (value is not None or name in "ACQR"):
            shape = "...", *shapes[name]
            array = (
                as_covariance(name, value) if name in "QR" else finite_array(name, value, *shape)
            )
            vars(model)[name] = frozen(array)
    sizes = {letter: _size(model, letter, shapes, *options.get(letter, ())) for letter in "np"}
    sizes["q"] = 0
    if model.G is not None or model.H is not None:
        sizes["q"] = _size(model, "q", shapes)
        for name, rows in ("G", "n"), ("H", "p"):
            if getattr(model, name) is None:
                vars(model)[name] = frozen(np.zeros((sizes[rows], sizes["q"])))
    for name, letters in shapes.items():
        shape = sizes[letters[0]], sizes.get(letters[1])
        table = _nominal(model, name)
        if table is not None and table.shape[-2:] != (shape[0], shape[1] or table.shape[-1]):
            expected = ", ".join("m" if each is None else str(each) for each in shape)
            raise ValueError(f"{name} has shape {table.shape}, expected (..., {expected})")
    vars(model).update(sizes)
    for name, size in ("state_angles", sizes["n"]), ("measurement_angles", sizes["p"]):
        indices = getattr(model, name)
        try:
            angles = tuple(operator.index(i) for i in indices)
        except TypeError:
            angles = (-1,)
        if any(not 0 <= i < size for i in angles):
            raise ValueError(f"{name} must be indices below {size}, got {short_repr(indices)}")
        vars(model)[name] = angles


def _size(
    model: Any, letter: str, shapes: dict[str, str], option: str = "", given: int | None = None
) -> int:
    """A size ``given`` as an option, or taken from the first array or table that has it."""
    if given is not None:
        return integer(option, given, 1)
    names = [name for name, shape in shapes.items() if letter in shape and name != "B"]
    for name in names:
        if (array := _nominal(model, name)) is not None:
            return array.shape[shapes[name].rindex(letter) - 2]
    remedy = f"{option}=, or " if option else ""
    raise ValueError(
        f"cannot tell {option or letter}: give {remedy}one of {', '.join(names)} as an array, not"
        " as a function"
    )


def _nominal(model: Any, name: str) -> np.ndarray | None:
    """The array of a matrix: itself, its table, or the nominal one; None for functions."""
    matrix = getattr(model, name)
    array = matrix if isinstance(matrix, np.ndarray) else getattr(matrix, "nominal", None)
    return matrix.table if isinstance(matrix, Schedule) else array

"""Build ``jaxmc/integration/data/joe_kuo.npz`` from the table that SciPy installs: ``python tools/sobol_table.py``.

The numbers are those of S. Joe and F. Y. Kuo (SIAM J. Sci. Comput. 30, 2008), file new-joe-kuo-6, dimensions 1 to 2048:
    polynomial  (2048,)     bits of the primitive polynomial over GF(2), the leading and the constant one included:
                            x^3 + x + 1 is 0b1011. The first dimension, van der Corput's, has none; its entry is 1.
    initial     (2048, 15)  m_1 .. m_s, s the degree, each m_k odd and below 2^k; then zeros.
Both are uint16, the smallest type that holds a degree of 15.
"""

from pathlib import Path

import numpy as np
import scipy.stats

DIM = 2048
SOURCE = Path(scipy.stats.__file__).parent / "_sobol_direction_numbers.npz"
FILE = Path(__file__).parents[1] / "jaxmc/integration/data/joe_kuo.npz"


def main():
    """Write the file. Raises ValueError when SciPy's table is not encoded as it was when this was written."""
    with np.load(SOURCE) as table:
        polynomial, initial = table["poly"][:DIM], table["vinit"][:DIM]
    degree = np.array([int(p).bit_length() - 1 for p in polynomial])
    k = np.arange(initial.shape[1])
    used = k < np.maximum(degree, 1)[:, None]
    if not (np.all(polynomial % 2 == 1) and np.all(initial[used] % 2 == 1) and not initial[~used].any()):
        raise ValueError(f"{SOURCE} is not encoded as expected; see the docstring of {Path(__file__).name}")
    if np.any(initial >= 2 ** (k + 1)) or max(polynomial.max(), initial.max()) >= 1 << 16:
        raise ValueError(f"{SOURCE} holds numbers too large for their places")
    initial = initial[:, : degree.max()]
    np.savez_compressed(FILE, polynomial=polynomial.astype(np.uint16), initial=initial.astype(np.uint16))
    print(f"wrote {FILE}: {FILE.stat().st_size} bytes, degrees up to {degree.max()}")


if __name__ == "__main__":
    main()

def warped(size):
    """Return the powers of each term: M1, and the product of camera row and panel column."""
    inputs = [tuple(int(i == j) for i in range(size)) for j in range(size)]
    product = tuple(int(i in (1, 2)) for i in range(size))
    return [(0,) * size, *inputs, product]

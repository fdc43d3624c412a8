"""The paper's score and what counts as a failure, of NumPy arrays and of tensors alike."""

BOX_POSITION, BOX_ANGLE = 0.05, 0.05  # m, rad
FAILURE_POSITION, FAILURE_ANGLE = 1.8, 0.8  # m, rad


def in_box(state):
    """The paper's score: whether |x| <= 0.05 m and |theta| <= 0.05 rad, for states [..., 4] with x_d = 0."""
    return (abs(state[..., 0]) <= BOX_POSITION) & (abs(state[..., 1]) <= BOX_ANGLE)


def has_failed(state):
    """Whether |x| > 1.8 m or |theta| > 0.8 rad, for states [..., 4]."""
    return (abs(state[..., 0]) > FAILURE_POSITION) | (abs(state[..., 1]) > FAILURE_ANGLE)

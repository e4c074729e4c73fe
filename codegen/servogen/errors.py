"""The one exception for everything wrong with what the user gave."""


class SceneError(ValueError):
    """Raised at generation; the message names the thing at fault and the remedy."""

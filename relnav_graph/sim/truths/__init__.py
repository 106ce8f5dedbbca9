"""How a pass really was: dynamics that the estimators do not share."""

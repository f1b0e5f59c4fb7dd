"""Episodes recorded and drawn, with what an explainer says of them."""

"""What an explainer is, what people bring as one, and the controls and oracle beside it."""

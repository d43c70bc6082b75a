"""One module per detector: how an experiment sets it up."""

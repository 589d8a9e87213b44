"""From a study to stored rows: plan, dispatch, collect, and what to do when a worker dies."""

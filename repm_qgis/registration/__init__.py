"""Registration of a scene to a reference: where its own surface lies on heights whose place is known."""

"""Between a policy server and its clients: messages, their checks, and the client's connection: docs/own_policy.md."""

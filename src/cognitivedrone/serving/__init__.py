"""The policy server: pilots over websocket in openpi's protocol, and over OpenVLA's REST. See docs/own_policy.md."""

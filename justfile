# The same commands by name, for those who have just (https://just.systems). CONTRIBUTING.md says what they are.

# Lists these.
default:
    @just --list

# The service, with human games and a simulated hallway in it: `just demo --duration 20s`.
demo *arguments:
    cargo run --release -- demo {{ arguments }}

# The tests, or some of them: `just test --test it faces`.
test *arguments:
    cargo test --locked {{ arguments }}

# All that must pass before a change lands.
ci:
    .ci/run

# Disks that fail, power cuts, kills, overload, at length, or some kinds of them: `just long power_cuts`.
long *kinds:
    .ci/long {{ kinds }}

# One benchmark beside its yardsticks, or a part of it: `just bench query grpc`.
bench name *part:
    cargo bench --locked --bench {{ name }} -- {{ part }}

# Formats the code and the protos.
fmt:
    cargo fmt --all
    if [ -x .venv/bin/buf ]; then .venv/bin/buf format proto --write; fi

# Documentation of the code, the tables that are made of it, and whether links lead somewhere.
docs:
    NUDGE_WRITE_DOCS=1 cargo test --locked --lib the_page_tells_what_each_endpoint_wants
    NUDGE_WRITE_DOCS=1 cargo test --locked --test it the_table_of_metrics_is_made_of_the_code
    .ci/links
    cargo doc --locked --no-deps --open

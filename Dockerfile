# syntax=docker/dockerfile:1

FROM rust:1.95-bookworm AS build
WORKDIR /nudge
COPY . .
# The registry and the compiled dependencies are kept between builds, so a change of ours costs only ours.
RUN --mount=type=cache,target=/usr/local/cargo/registry \
    --mount=type=cache,target=/nudge/target \
    cargo build --release --locked && cp target/release/nudge /usr/local/bin/nudge && mkdir /data

# No shell and no package manager; user 65532 is `nonroot`.
FROM gcr.io/distroless/cc-debian12:nonroot
COPY --from=build /usr/local/bin/nudge /usr/local/bin/nudge
COPY --from=build --chown=65532:65532 /data /data
VOLUME /data
ENV NUDGE_LISTEN=0.0.0.0:8080 NUDGE_DATA=/data
EXPOSE 8080
STOPSIGNAL SIGTERM
ENTRYPOINT ["nudge"]
CMD ["serve"]

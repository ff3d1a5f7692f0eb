# syntax=docker/dockerfile:1

# docker build --build-arg NUDGE_REVISION="$(git rev-parse HEAD)" -t nudge .
# There is no history in the build, so it is told which revision it is: `nudge --version`, nudge_build_info and the label say it.
ARG NUDGE_REVISION=unknown

FROM rust:1.95-bookworm AS build
ARG NUDGE_REVISION
WORKDIR /nudge
COPY . .
# The registry and the compiled dependencies are kept between builds, so a change of ours costs only ours.
RUN --mount=type=cache,target=/usr/local/cargo/registry \
    --mount=type=cache,target=/nudge/target \
    cargo build --release --locked && cp target/release/nudge /usr/local/bin/nudge && mkdir /data

# No shell and no package manager; user 65532 is `nonroot`.
FROM gcr.io/distroless/cc-debian12:nonroot
ARG NUDGE_REVISION
LABEL org.opencontainers.image.title="nudge" \
      org.opencontainers.image.licenses="MIT" \
      org.opencontainers.image.revision="${NUDGE_REVISION}"
COPY --from=build /usr/local/bin/nudge /usr/local/bin/nudge
COPY --from=build --chown=65532:65532 /data /data
VOLUME /data
ENV NUDGE_LISTEN=0.0.0.0:8080 NUDGE_DATA=/data
EXPOSE 8080
STOPSIGNAL SIGTERM
# It asks the service that NUDGE_LISTEN and NUDGE_TLS_CERT describe.
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 CMD ["nudge", "health"]
ENTRYPOINT ["nudge"]
CMD ["serve"]

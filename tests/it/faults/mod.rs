//! The fault programme: what breaks around the service, and that nothing is lost or counted twice by it.

/// Returns whether the long form was asked for.
pub fn long() -> bool {
    std::env::var("NUDGE_LONG").is_ok_and(|told| !["", "0"].contains(&told.as_str()))
}

/// Returns how much of something the short or the long form does.
pub fn scaled(short: u64, long_form: u64) -> u64 {
    if long() { long_form } else { short }
}

//! Redaction: secrets that stand where they should not, in an argument, a variable or a line of a
//! file, are not shown.

use crate::domain::Secret;

/// How a secret in PEM begins, and what ends it.
const PEM: [&str; 2] = ["-----BEGIN ", "-----END "];

/// So many digits of base 64 in a row are taken for a secret: 18 bytes of one.
const DIGITS: usize = 24;

/// So many digits of base 16 are taken for a part of a secret, where there may be parts of one.
const PART: usize = 8;

/// Returns a text without what looks like a secret: a key, PEM, or a long row of digits of base 16
/// or 64.
pub fn redacted(text: &str) -> String {
    let mut told = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(PEM[0]) {
        told += &words(&rest[..at]);
        told += "(PEM, not shown)";
        rest = after_pem(&rest[at..]);
    }
    told + &words(rest)
}

/// Returns whether a key as they are made here stands in a text, or the beginning of one.
pub fn has_key(text: &str) -> bool {
    text.match_indices(Secret::PREFIX).any(|(at, _)| {
        let behind = &text.as_bytes()[at + Secret::PREFIX.len()..];
        behind.len() >= PART && behind.iter().take(PART).all(u8::is_ascii_hexdigit)
    })
}

/// Returns a text of a keys file for an error, unless there may be a part of a key in it; nothing
/// of a long one.
pub(super) fn harmless(text: &str) -> String {
    const MOST: usize = 40;

    let may_be_part = text
        .split(|char: char| !char.is_ascii_hexdigit())
        .any(is_part);
    if may_be_part || text.chars().count() > MOST || redacted(text) != text {
        return not_shown(text);
    }

    format!("{text:?}")
}

/// Returns whether a run of hexadecimal digits is long and mixed enough for a part of a key.
fn is_part(run: &str) -> bool {
    run.len() >= PART && has(run, char::is_alphabetic) && has(run, char::is_numeric)
}

/// Skips a document in PEM, to its end where it has one.
fn after_pem(text: &str) -> &str {
    let Some(at) = text.find(PEM[1]) else {
        return "";
    };
    let end = &text[at + PEM[1].len()..];
    end.find("-----")
        .map_or("", |at| &end[at + "-----".len()..])
}

/// Returns a text without the words in it that look like secrets.
fn words(text: &str) -> String {
    let mut told = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let is_word = is_in_word(first);
        let end = rest
            .find(|char| is_in_word(char) != is_word)
            .unwrap_or(rest.len());
        let (word, behind) = rest.split_at(end);
        match is_word && is_secret(word) {
            true => told += &not_shown(word),
            false => told += word,
        }
        rest = behind;
    }

    told
}

fn is_in_word(char: char) -> bool {
    char.is_ascii_alphanumeric() || "+/_-=.~".contains(char)
}

/// Returns whether a word looks like a secret. Paths and names are long too, but their parts are
/// short or of small letters.
fn is_secret(word: &str) -> bool {
    // Base 64 has slashes too, and no path without a slash or a dot at its beginning is as mixed.
    let is_path = word.starts_with(['/', '.', '~']);

    has_key(word)
        || word
            .split(|char: char| !(char.is_ascii_alphanumeric() || char == '+'))
            .any(is_row)
        || word.split(['/', '.', '~', '=']).any(is_mixed)
        || (!is_path && word.split(['.', '~', '=', '-', '_']).any(is_mixed))
}

fn is_row(row: &str) -> bool {
    row.len() >= DIGITS
}

fn is_mixed(row: &str) -> bool {
    is_row(row)
        && has(row, char::is_lowercase)
        && has(row, char::is_uppercase)
        && has(row, char::is_numeric)
}

fn has(text: &str, is: impl Fn(char) -> bool) -> bool {
    text.chars().any(is)
}

fn not_shown(text: &str) -> String {
    format!("({} characters, not shown)", text.chars().count())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::generate;

    /// 48 bytes in base 64, with slashes where they cut it most.
    const BASE64: &str = "MIGHAgEAMBMGByqGSM/9AgEGCCqGSM49AwEHBG0wawI/AQEEIHQ0b9v5Hq1x";

    fn key() -> String {
        generate().expect("randomness").reveal().to_owned()
    }

    #[test]
    fn what_looks_like_a_secret_is_not_shown() {
        let key = key();
        let pem = format!("-----BEGIN PRIVATE KEY-----\n{BASE64}\n-----END PRIVATE KEY-----\n");
        let half = &pem[..70];
        for secret in [
            &key,
            &key[6..],
            &key[6..40],
            &key.to_uppercase(),
            BASE64,
            "c2VjcmV0LXNlY3JldC1zZWNyZXQ=",
            &pem,
            half,
        ] {
            for text in [
                secret.to_owned(),
                format!("x={secret}"),
                format!("--keys {secret:?}: no"),
                format!("a {secret} b"),
            ] {
                let told = redacted(&text);
                let inside = if secret.contains("BEGIN") {
                    &BASE64[..20]
                } else {
                    &secret[8..20]
                };
                assert!(
                    !told.contains(inside) && told.contains("not shown"),
                    "{text}: {told}"
                );
            }
        }
        let around = redacted(&format!("error: {pem:?} is no file"));
        assert_eq!(around, "error: \"(PEM, not shown)\\n\" is no file");
    }

    #[test]
    fn paths_names_and_sentences_are_shown() {
        for text in [
            "",
            "/etc/nudge/keys.txt",
            "/var/lib/some-organisation/very/long/path/to/the/certificates/of-the-service/tls.crt",
            "./nudge_keys/nudge_key.txt",
            "/tmp/.tmpAb12Cd/data/nudge.db",
            "--max-connection-age",
            "nudge_tls_certificate_expires_timestamp_seconds",
            "0b5f6c1e-8f3a-4c59-9d1e-2a7b6c5d4e3f",
            "http://nudge.example.org:8080/v1/environments/hallway-7",
            "a long name such as the_environment_of_somebody_with_patience, é",
        ] {
            assert_eq!(redacted(text), text);
        }
    }

    #[test]
    fn a_part_of_a_key_is_not_shown_in_errors_about_its_file() {
        let key = key();
        for part in [
            &key[..],
            &key[6..46],
            &key[6..30],
            &format!("rate={}", &key[..30]),
        ] {
            assert!(!harmless(part).contains(&part[6..14]), "{part}");
        }
        assert_eq!(harmless("all"), "\"all\"");
        assert_eq!(harmless("50/d"), "\"50/d\"");
    }
}

//! Key generation, from the randomness of the operating system.

use crate::domain::Secret;

/// Makes a key of 256 bits.
pub fn generate() -> Result<Secret, String> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes)
        .map_err(|error| format!("the operating system gives no randomness: {error}"))?;
    Ok(Secret::of_random(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_is_made_twice() {
        let [one, other] = [(); 2].map(|()| generate().expect("randomness"));
        assert!(one != other && one.digest() != other.digest());
    }
}

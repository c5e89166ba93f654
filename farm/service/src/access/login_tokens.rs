//! Tokens in the addresses of pages: each of them signs in one browser.

use std::fmt;
use std::sync::Arc;

use femc_trust::{Token, TrustError};
use tokio::sync::watch;

/// Source of tokens for addresses of pages. A browser exchanges the current token for the session's token, which becomes its cookie.
/// The exchange replaces the current token. Clones share it.
#[derive(Clone)]
pub struct LoginTokens {
    session: Arc<str>,
    current: watch::Sender<Token>,
}

impl LoginTokens {
    /// Creates a source.
    /// - `session`: token that browsers receive. It must be in the list of valid tokens.
    pub fn new(session: String) -> Result<Self, TrustError> {
        Ok(Self { session: session.into(), current: watch::Sender::new(Token::random()?) })
    }

    /// Returns a receiver of the current token. It is notified when a browser has used the token.
    pub fn subscribe(&self) -> watch::Receiver<Token> {
        self.current.subscribe()
    }

    /// Exchanges the current token for the session's token, once. Returns `None` for any other token.
    pub(crate) fn exchange(&self, token: &str) -> Option<&str> {
        let presented = Token::parse(token)?.digest();
        let next = Token::random().ok()?;
        let exchange = |current: &mut Token| {
            let is_current = current.digest() == presented;
            if is_current {
                *current = next;
            }
            is_current
        };
        self.current.send_if_modified(exchange).then_some(&*self.session)
    }
}

impl fmt::Debug for LoginTokens {
    /// Formats no secrets.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LoginTokens").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_exchanged_once_and_the_next_one_is_announced() {
        let logins = LoginTokens::new("the session".into()).unwrap();
        let mut receiver = logins.subscribe();
        let first = receiver.borrow_and_update().secret();
        for wrong in ["", "the session", &Token::random().unwrap().secret(), &first[..20]] {
            assert_eq!(logins.exchange(wrong), None);
        }
        assert!(!receiver.has_changed().unwrap());
        assert_eq!(logins.exchange(&first), Some("the session"));
        assert_eq!(logins.exchange(&first), None);
        assert!(receiver.has_changed().unwrap());
        let second = receiver.borrow_and_update().secret();
        assert_eq!(logins.clone().exchange(&second), Some("the session"));
        assert!(!format!("{logins:?}").contains("session\""));
    }

    #[test]
    fn of_browsers_that_arrive_at_once_one_is_signed_in() {
        let logins = LoginTokens::new("the session".into()).unwrap();
        let token = logins.subscribe().borrow().secret();
        let won = std::thread::scope(|scope| {
            let tries: Vec<_> = (0..8).map(|_| scope.spawn(|| logins.exchange(&token).is_some())).collect();
            tries.into_iter().map(|it| it.join().unwrap()).filter(|won| *won).count()
        });
        assert_eq!(won, 1);
    }
}

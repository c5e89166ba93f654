/** Sign-in with the token that `femc view` puts into the fragment of its address. */

import { ApiError } from './api';

const LOOPBACK_HOSTS = new Set(['127.0.0.1', 'localhost', '[::1]']);

/**
 * Chooses what the page does with a token from the address: it submits the token without a click only to a server of this machine, and only
 * for a visitor who is not signed in. Otherwise, a link could sign a visitor in as somebody else. A visitor who is signed in goes on to
 * the page: the token of an address is valid once, and may have signed in this browser.
 * - `me`: requests the identity of the visitor
 */
export async function useOfToken(hostname: string, me: () => Promise<unknown>): Promise<'submit' | 'continue' | 'ask'> {
  if (!LOOPBACK_HOSTS.has(hostname)) return 'ask';
  try {
    await me();
    return 'continue';
  } catch (error) {
    return error instanceof ApiError && error.status === 401 ? 'submit' : 'ask';
  }
}

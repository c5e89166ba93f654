/** Sign-in with the token that `femc view` puts into the fragment of its address. */

import { ApiError } from './api';

const LOOPBACK_HOSTS = new Set(['127.0.0.1', 'localhost', '[::1]']);

/**
 * Checks whether the page may submit a token from the address without a click: only to a server of this machine, and only for a visitor
 * who is not signed in. Otherwise, a link could sign a visitor in as somebody else.
 * - `me`: requests the identity of the visitor
 */
export async function maySubmitToken(hostname: string, me: () => Promise<unknown>): Promise<boolean> {
  if (!LOOPBACK_HOSTS.has(hostname)) return false;
  try {
    await me();
    return false;
  } catch (error) {
    return error instanceof ApiError && error.status === 401;
  }
}

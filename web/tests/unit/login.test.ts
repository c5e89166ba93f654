import { describe, expect, test, vi } from 'vitest';
import { ApiError } from '../../src/lib/api';
import { maySubmitToken } from '../../src/lib/login';

describe('a token in the address', () => {
  const denied = () => Promise.reject(new ApiError(401, 'unauthorized', 'sign in'));

  test.each(['127.0.0.1', 'localhost', '[::1]'])('is submitted to %s if nobody is signed in', async (host) => {
    expect(await maySubmitToken(host, denied)).toBe(true);
    expect(await maySubmitToken(host, () => Promise.resolve({ user: 'ada' }))).toBe(false);
    expect(await maySubmitToken(host, () => Promise.reject(new ApiError(503, 'busy', 'try again')))).toBe(false);
    expect(await maySubmitToken(host, () => Promise.reject(new Error('no')))).toBe(false);
  });

  test.each(['farm.example', '127.0.0.1.example', 'localhost.example', '10.0.0.1', '::1'])('is not submitted to %s', async (host) => {
    const me = vi.fn(denied);
    expect(await maySubmitToken(host, me)).toBe(false);
    expect(me).not.toHaveBeenCalled();
  });
});

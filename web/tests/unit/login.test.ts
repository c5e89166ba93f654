import { describe, expect, test, vi } from 'vitest';
import { ApiError } from '../../src/lib/api';
import { useOfToken } from '../../src/lib/login';

describe('a token in the address', () => {
  const denied = () => Promise.reject(new ApiError(401, 'unauthorized', 'sign in'));

  test.each(['127.0.0.1', 'localhost', '[::1]'])('is submitted to %s if nobody is signed in', async (host) => {
    expect(await useOfToken(host, denied)).toBe('submit');
    expect(await useOfToken(host, () => Promise.resolve({ user: 'ada' }))).toBe('continue');
    expect(await useOfToken(host, () => Promise.reject(new ApiError(503, 'busy', 'try again')))).toBe('ask');
    expect(await useOfToken(host, () => Promise.reject(new Error('no')))).toBe('ask');
  });

  test.each(['farm.example', '127.0.0.1.example', 'localhost.example', '10.0.0.1', '::1'])('is not submitted to %s', async (host) => {
    const me = vi.fn(denied);
    expect(await useOfToken(host, me)).toBe('ask');
    expect(me).not.toHaveBeenCalled();
  });
});

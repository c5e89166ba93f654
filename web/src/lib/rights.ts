/** Access rights, as in docs/security.md. The coordinator decides; the pages do not offer what it would refuse. */

import type { Me, Role } from './types';

const ORDER: readonly Role[] = ['viewer', 'submitter', 'operator', 'admin'];

export type Right = { kind: 'job'; owner: string } | { kind: 'workers' } | { kind: 'audit' };

function atLeast(me: Me, role: Role): boolean {
  return me.role === null || ORDER.indexOf(me.role) >= ORDER.indexOf(role);
}

/** Returns the reason why an action is not allowed; null if it is. */
export function refusal(me: Me | null, readOnly: boolean, right: Right): string | null {
  if (!me) return 'It is not known yet who you are.';
  if (right.kind === 'audit') return atLeast(me, 'admin') ? null : `You are ${me.role}; this takes an admin.`;
  if (readOnly) return 'The page is set to read-only (top right).';
  if (right.kind === 'workers') return atLeast(me, 'operator') ? null : `You are ${me.role}; this takes an operator.`;
  if (atLeast(me, 'operator')) return null;
  if (!atLeast(me, 'submitter')) return `You are ${me.role}; this takes the job's owner or an operator.`;
  return right.owner === me.name ? null : `The job is ${right.owner}'s; this takes its owner or an operator.`;
}

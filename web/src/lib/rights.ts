/** Access rights, as in docs/security.md. The coordinator decides; the pages do not offer what it would refuse. */

import type { Me, Role } from './types';

const ORDER: readonly Role[] = ['viewer', 'submitter', 'operator', 'admin'];

export type Right = { kind: 'job'; owner: string } | { kind: 'workers' } | { kind: 'audit' };

function atLeast(me: Me, role: Role): boolean {
  return me.role === null || ORDER.indexOf(me.role) >= ORDER.indexOf(role);
}

/** Returns the reason why an action is not allowed; null if it is. */
export function refusal(me: Me | null, readOnly: boolean, right: Right): string | null {
  if (!me) return 'Your role is not known yet.';
  const requires = (who: string) => `Your role is ${me.role}. This requires ${who}.`;
  if (right.kind === 'audit') return atLeast(me, 'admin') ? null : requires('the role admin');
  if (readOnly) return 'The page is set to read-only (top right).';
  if (right.kind === 'workers') return atLeast(me, 'operator') ? null : requires('the role operator');
  if (atLeast(me, 'operator')) return null;
  if (!atLeast(me, 'submitter')) return requires("the job's owner or an operator");
  return right.owner === me.name ? null : `The job belongs to ${right.owner}. This requires the job's owner or an operator.`;
}

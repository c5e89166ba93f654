//! LM-63 files whose flux depends on the edition, on separators or on the encoding.

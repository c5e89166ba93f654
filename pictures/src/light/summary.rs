//! Light in numbers, as JSON.

use super::RecordedLight;
use femc_paths::query::Query;
use femc_paths::summary::{Estimate, Group, LightAmount, LightSummary, RowSubject};
use serde_json::{Map, Value, json};

/// Encodes the light of the selected records.
/// - `query`: query of the selection; `None`: all records.
pub fn encode_summary(light: &RecordedLight, query: Option<&Query>, summary: &LightSummary) -> Vec<u8> {
    let frames = light.paths.frames();
    let groups = Group::ALL.into_iter().zip(&summary.groups).map(|(group, rows)| {
        let rows = rows.iter().map(|(subject, amount)| encode_row(group, subject, amount)).collect();
        (group.word().to_owned(), Value::Array(rows))
    });
    let left_out = Group::ALL.into_iter().zip(summary.left_out);
    let answer = json!({
        "tag": light.tag,
        "text": query.and_then(Query::to_condition).map(|condition| condition.to_string()),
        "samples": frames.iter().map(|frame| frame.samples).sum::<u64>(),
        "recorded": light.paths.totals()[0],
        "share": light.paths.share(),
        "total": encode_amount(&summary.total),
        "groups": Map::from_iter(groups),
        "left_out": left_out.map(|(group, rows)| (group.word().to_owned(), json!(rows))).collect::<Map<_, _>>(),
    });
    answer.to_string().into_bytes()
}

fn encode_row(group: Group, subject: &RowSubject, amount: &LightAmount) -> Value {
    let mut row = encode_amount(amount);
    row["name"] = json!(subject.text());
    row["where"] = json!(subject.condition(group).map(|condition| condition.to_string()));
    row
}

fn encode_amount(amount: &LightAmount) -> Value {
    let estimate = |it: Estimate| json!({ "value": it.value, "standard_error": it.standard_error });
    json!({
        "paths": amount.paths,
        "light": estimate(amount.light),
        "records": amount.records,
        "per_path": estimate(amount.per_path),
        "energy": amount.energy.map(estimate),
    })
}

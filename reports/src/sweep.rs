//! Tables of a sweep as CSV and as Parquet.

use crate::ReportError;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;
use std::path::Path;
use std::sync::Arc;

/// Table with columns of equal length.
#[derive(Debug, Default)]
pub struct Table {
    columns: Vec<(String, Cells)>,
}

/// Cells of a column.
#[derive(Debug)]
pub enum Cells {
    /// Text.
    Text(Vec<String>),
    /// Measured numbers. A missing number is an empty cell.
    Number(Vec<Option<f64>>),
    /// Counts.
    Count(Vec<i64>),
}

impl Table {
    /// Adds a column on the right.
    pub fn add(&mut self, name: impl Into<String>, cells: Cells) {
        self.columns.push((name.into(), cells));
    }

    /// Writes `NAME.csv` and `NAME.parquet` into a folder.
    pub fn write(&self, folder: &Path, name: &str) -> Result<(), ReportError> {
        let parquet = self.to_parquet();
        let parquet =
            parquet.map_err(|cause| ReportError::Parquet { path: format!("{name}.parquet").into(), cause })?;
        for (extension, bytes) in [("csv", self.to_csv().into_bytes()), ("parquet", parquet)] {
            femc_film::file::write_atomic(&folder.join(format!("{name}.{extension}")), &bytes)?;
        }
        Ok(())
    }

    fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, cells)| cells.len())
    }

    /// Formats the table as RFC 4180, with a header and bare line feeds.
    fn to_csv(&self) -> String {
        let line = |cells: Vec<String>| cells.join(",") + "\n";
        let header = line(self.columns.iter().map(|(name, _)| quoted(name)).collect());
        let row = |at| line(self.columns.iter().map(|(_, cells)| cells.cell_text(at)).collect());
        header + &(0..self.rows()).map(row).collect::<String>()
    }

    fn to_parquet(&self) -> Result<Vec<u8>, ParquetError> {
        let fields = self.columns.iter().map(|(name, cells)| cells.field(name).map(Arc::new));
        let schema = Type::group_type_builder("sweep").with_fields(fields.collect::<Result<_, _>>()?).build()?;
        let mut bytes = Vec::new();
        let mut file = SerializedFileWriter::new(&mut bytes, Arc::new(schema), Arc::default())?;
        let mut rows = file.next_row_group()?;
        for (_, cells) in &self.columns {
            if let Some(mut column) = rows.next_column()? {
                cells.write(&mut column)?;
                column.close()?;
            }
        }
        rows.close()?;
        file.close()?;
        Ok(bytes)
    }
}

impl Cells {
    fn len(&self) -> usize {
        match self {
            Self::Text(cells) => cells.len(),
            Self::Number(cells) => cells.len(),
            Self::Count(cells) => cells.len(),
        }
    }

    fn cell_text(&self, at: usize) -> String {
        match self {
            Self::Text(cells) => quoted(&cells[at]),
            Self::Number(cells) => cells[at].map_or(String::new(), |number| number.to_string()),
            Self::Count(cells) => cells[at].to_string(),
        }
    }

    fn field(&self, name: &str) -> Result<Type, ParquetError> {
        let (physical, repetition, logical) = match self {
            Self::Text(_) => (Physical::BYTE_ARRAY, Repetition::REQUIRED, Some(LogicalType::String)),
            Self::Number(_) => (Physical::DOUBLE, Repetition::OPTIONAL, None),
            Self::Count(_) => (Physical::INT64, Repetition::REQUIRED, None),
        };
        let field = Type::primitive_type_builder(name, physical).with_repetition(repetition);
        field.with_logical_type(logical).build()
    }

    fn write(&self, column: &mut SerializedColumnWriter<'_>) -> Result<(), ParquetError> {
        match self {
            Self::Text(cells) => {
                let cells: Vec<ByteArray> = cells.iter().map(|text| text.as_str().into()).collect();
                column.typed::<ByteArrayType>().write_batch(&cells, None, None)?;
            }
            Self::Number(cells) => {
                let there: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
                let numbers: Vec<f64> = cells.iter().flatten().copied().collect();
                column.typed::<DoubleType>().write_batch(&numbers, Some(&there), None)?;
            }
            Self::Count(cells) => {
                column.typed::<Int64Type>().write_batch(cells, None, None)?;
            }
        }
        Ok(())
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};

    fn table() -> Table {
        let mut table = Table::default();
        table.add("variant", Cells::Text(vec!["a=1,b=2".into(), "say \"x\"".into()]));
        table.add("luminance", Cells::Number(vec![Some(0.1), None]));
        table.add("frames", Cells::Count(vec![10, 0]));
        table
    }

    #[test]
    fn a_csv_quotes_what_would_be_read_as_two_cells() {
        assert_eq!(table().to_csv(), "variant,luminance,frames\n\"a=1,b=2\",0.1,10\n\"say \"\"x\"\"\",,0\n");
    }

    #[test]
    fn a_parquet_file_reads_back_with_its_types_and_gaps() {
        let bytes = table().to_parquet().expect("bytes");
        let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).expect("a parquet file");
        let rows: Vec<String> =
            reader.get_row_iter(None).expect("rows").map(|row| row.expect("a row").to_string()).collect();
        assert_eq!(
            rows,
            [
                "{variant: \"a=1,b=2\", luminance: 0.1, frames: 10}",
                "{variant: \"say \"x\"\", luminance: null, frames: 0}"
            ]
        );
    }
}
